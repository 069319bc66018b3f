"""Families on Gymnasium's robots, beside Gymnasium and a NumPy transcription of the sources."""

import importlib.util
from collections.abc import Callable
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from maesn import cli
from maesn.envs import Body, CheetahBody, cheetah_body, cheetah_dir, find_family
from maesn.envs.cheetah import drawn_velocities
from maesn.physics import NativeSimulator, load_model

V5 = {
    "cheetah_vel": "HalfCheetah-v5",
    "cheetah_dir": "HalfCheetah-v5",
    "cheetah_body": "HalfCheetah-v5",
    "ant_dir": "Ant-v5",
    "ant_goal": "Ant-v5",
    "sparse_ant_goal": "Ant-v5",
}
# Positions are shown where the task is one.
SHOWN = {"ant_goal": {"exclude_current_positions_from_observation": False}}
SHOWN["sparse_ant_goal"] = SHOWN["ant_goal"]
STEPS = 200


@pytest.fixture(autouse=True)
def quiet() -> Any:
    """MuJoCo 4 finds an attribute of Gymnasium's cheetah deprecated, and says so of every one."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    yield
    mujoco.set_mju_user_warning(before)


def gymnasium_env(name: str, **settings: Any) -> Any:
    return gymnasium.make(V5[name], **SHOWN.get(name, {}), **settings).unwrapped


def simulator(name: str) -> NativeSimulator:
    env: Any = find_family(name).make_env()
    return NativeSimulator(env.model, 1, env.readings, env.frame_skip, 1, env.nonfinite)


def first(readings: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: value[0] for name, value in readings.items()}


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", ["cheetah_vel", "ant_dir", "ant_goal"])
def test_dynamics_and_observations_are_those_of_gymnasium(name: str, seed: int) -> None:
    env, theirs, ours = find_family(name).make_env(), gymnasium_env(name), simulator(name)
    np.testing.assert_array_equal(env.standing, theirs.init_qpos)  # type: ignore[attr-defined]
    theirs.reset(seed=seed)
    ours.reset(theirs.data.qpos[None].copy(), theirs.data.qvel[None].copy())
    rng, exact = np.random.default_rng(seed), mujoco.MjData(theirs.model)
    for _ in range(STEPS):
        action = rng.uniform(-1.0, 1.0, theirs.model.nu).astype(np.float32)
        expected = theirs.step(action)[0]
        readings = first(ours.step(np.asarray(env.control(jnp.asarray(action)), float)[None]))
        for quantity in ("qpos", "qvel"):
            there = getattr(theirs.data, quantity)
            np.testing.assert_allclose(readings[quantity], there, rtol=1e-6, atol=1e-9)
        size = theirs.model.nq + theirs.model.nv - (0 if name == "ant_goal" else 2)
        observed = np.asarray(env.observe({k: jnp.asarray(v) for k, v in readings.items()}))
        assert observed.shape == expected.shape == theirs.observation_space.shape
        np.testing.assert_allclose(observed[:size], expected[:size], rtol=1e-5, atol=1e-5)
        if "cfrc_ext" in readings:  # v5's belong to a state within the step; these to the last one
            exact.qpos[:], exact.qvel[:] = theirs.data.qpos, theirs.data.qvel
            exact.ctrl[:] = theirs.data.ctrl
            mujoco.mj_forward(theirs.model, exact)
            mujoco.mj_rnePostConstraint(theirs.model, exact)
            np.testing.assert_allclose(readings["cfrc_ext"], exact.cfrc_ext, rtol=1e-3, atol=1e-3)
            np.testing.assert_array_equal(
                observed[-78:], np.clip(readings["cfrc_ext"], -1, 1)[1:].astype(np.float32).ravel()
            )
    theirs.close()


def source_reward(name: str, velocity: Any, after: Any, action: Any, forces: Any, task: Any) -> Any:
    """Goal part and the rest of the reward: `step` of oyster, of hyperx, and of RoML."""
    contact = 0.5 * 1e-3 * np.sum(np.square(np.clip(forces, -1, 1)))
    control = np.square(np.clip(action, -1, 1)).sum()
    away = after[:2] - task if "goal" in name else np.zeros(2)
    distance = np.linalg.norm(away, ord=2)
    cheetah = -0.5 * 1e-1 * control
    return {
        "cheetah_vel": lambda: (-1.0 * abs(velocity[0] - task), cheetah),
        "cheetah_dir": lambda: (task * velocity[0], cheetah),
        "cheetah_body": lambda: (velocity[0] + after[1], cheetah),
        "ant_dir": lambda: (np.dot(velocity, task), 1.0 - 0.5 * control - contact),
        "ant_goal": lambda: (-np.sum(np.abs(away)), -0.1 * control - contact),
        "sparse_ant_goal": lambda: (
            1.0 - distance if distance <= 0.75 else -0.75,
            -0.01 * control - contact,
        ),
    }[name]()


@pytest.mark.parametrize("reward_kind", ["dense", "sparse"])
@pytest.mark.parametrize("name", V5)
def test_rewards_and_ends_are_those_of_the_sources(name: str, reward_kind: Any) -> None:
    family = find_family(name)
    env: Any = family.make_env(reward_kind=reward_kind)
    assert (env.horizon, env.control_period, env.frame_skip) == (200, 0.05, 5)
    rng, tasks, solved = np.random.default_rng(0), family.task_set("test"), 0
    is_ant = V5[name] == "Ant-v5"
    for row in range(60):
        task = jax.tree.map(lambda x: x[row % len(tasks)], tasks.tasks)  # noqa: B023
        before, after = ({"qpos": env.standing + rng.normal(0, 0.3, len(env.standing)),
                          "qvel": rng.normal(0, 1, env.num_speeds)} for _ in range(2))  # fmt: skip
        if "goal" in name and row % 2:
            after["qpos"][:2] = task + rng.normal(0, 0.4, 2)
        if is_ant:
            for state in (before, after):
                state["cfrc_ext"] = rng.normal(0, 1, (14, 6))
        velocity = (after["qpos"][:2] - before["qpos"][:2]) / 0.05
        action = rng.normal(0, 1, env.action_size)
        forces = after.get("cfrc_ext", np.zeros(1))
        expected = source_reward(name, velocity, after["qpos"], action, forces, task)
        before, after, task = jax.tree.map(jnp.asarray, (before, after, task))
        action = jnp.asarray(action)
        reward = env.reward(before, action, after, task)
        np.testing.assert_allclose((reward.goal, reward.other), expected, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(
            env.observed_reward("sparse", before, action, after, task), sum(expected), rtol=1e-3
        )
        height = float(after["qpos"][2])
        assert env.terminated(after) == (name == "ant_dir" and not 0.2 <= height <= 1.0)
        solved += int(env.solved(after, task))
    assert (solved > 0) == env.defines_success == ("goal" in name)
    if is_ant:  # a state that blew up has the reward of the one before
        lost = after | {"qvel": after["qvel"].at[0].set(jnp.nan)}
        assert env.terminated(lost)
        assert np.isfinite(env.reward(before, action, lost, task).total)


@pytest.mark.parametrize("name", V5)
def test_starts_scatter_as_those_of_gymnasium(name: str) -> None:
    family = find_family(name)
    env: Any = family.make_env()
    task = jax.tree.map(lambda x: jnp.asarray(x[0]), family.task_set("test").tasks)
    qpos, qvel = jax.vmap(lambda key: env.initial(key, task))(
        jax.random.split(jax.random.key(0), 400)
    )
    moved = np.asarray(qpos) - env.standing
    assert 0.099 < np.abs(moved).max() <= 0.1 + 1e-6
    np.testing.assert_allclose(moved.std(0), 0.1 / np.sqrt(3), rtol=0.15)
    np.testing.assert_allclose(np.asarray(qvel).std(0), 0.1, rtol=0.15)


@pytest.mark.parametrize("factor", [(2.0, 1.0, 1.0), (1.0, 0.5, 1.0), (1.0, 1.0, 0.5)])
def test_a_body_is_gymnasiums_cheetah_with_other_numbers(factor: Any) -> None:
    env, theirs, ours = CheetahBody(), gymnasium_env("cheetah_body"), simulator("cheetah_body")
    body = Body(*jnp.asarray(factor))
    theirs.model.body_mass[:] *= factor[0]
    theirs.model.body_inertia[:] *= factor[0]
    theirs.model.dof_damping[:] *= factor[1]
    theirs.model.geom_friction[:] *= factor[2]
    mujoco.mj_setConst(theirs.model, theirs.data)
    theirs.reset(seed=3)
    fields = {name: np.asarray(x)[None] for name, x in env.model_fields(body).items()}
    start = theirs.data.qpos[None].copy(), theirs.data.qvel[None].copy()
    ours.reset(*start, fields)
    plain = simulator("cheetah_body")
    plain.reset(*start)
    rng = np.random.default_rng(3)
    for _ in range(20):  # fields travel in single precision
        action = rng.uniform(-1.0, 1.0, (1, 6)).astype(np.float32).astype(float)
        theirs.step(action[0])
        moved, unlike = ours.step(action)["qpos"][0], plain.step(action)["qpos"][0]
        np.testing.assert_allclose(moved, theirs.data.qpos, rtol=1e-4, atol=1e-4)
    assert np.abs(moved - unlike).max() > 1e-2


def test_tasks_are_drawn_as_in_the_sources() -> None:
    rng, many = np.random.default_rng(0), 20_000
    speed, angle, goal, body = (
        find_family(name).draw_tasks(rng, many)
        for name in ("cheetah_vel", "ant_dir", "ant_goal", "cheetah_body")
    )
    np.testing.assert_allclose(np.quantile(speed, [0, 0.5, 1]), [0, 1.5, 3], atol=0.05)
    np.testing.assert_allclose(np.linalg.norm(angle, axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(angle.mean(0), 0.0, atol=0.02)
    away = np.linalg.norm(goal, axis=1)
    assert away.max() <= 3.0
    np.testing.assert_allclose((away <= 0.75).mean(), 0.0625, atol=0.01)  # start solved
    for factors in body:
        np.testing.assert_allclose(np.quantile(factors, [0, 0.5, 1]), [0.5, 1, 2], atol=0.05)
    assert cheetah_dir.task_set("test").tasks.tolist() == [-1, 1]
    np.random.seed(1337)  # noqa: NPY002, as oyster has it
    expected = np.random.uniform(0.0, 3.0, size=(130,))  # noqa: NPY002
    np.testing.assert_array_equal(drawn_velocities(130), expected.astype(np.float32))


def test_a_body_of_no_mass_is_refused() -> None:
    with pytest.raises(ValueError, match=r"`damping` must be positive, got 0\.0 in row 1"):
        cheetah_body.check_tasks(Body(np.ones(2), np.array([1.0, 0.0]), np.ones(2)))


def test_without_gymnasium_a_sentence_names_the_extra(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found: Callable[..., Any] = importlib.util.find_spec

    def without(name: str, *rest: Any) -> Any:
        return None if name == "gymnasium" else found(name, *rest)

    monkeypatch.setattr("maesn.physics.loading.find_spec", without)
    words = ["train", "maesn", "--family", "cheetah_vel", "--run", str(tmp_path / "run")]
    assert cli.run(words) == cli.USAGE_ERROR
    said = capsys.readouterr().err
    assert "Gymnasium, which is not installed: pip install -e '.[gym]'" in said
    assert load_model("wheeled").nu == 2
