"""The guide to an own family on a MuJoCo model, taken at its word: its files, its commands."""

from pathlib import Path
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from guides import Guide
from pictures import can_draw

from maesn.envs import NAMED_SETS, TaskSet
from maesn.worlds import HostWorld, make_world, open_stepper

GUIDE = Guide("own_environment_mujoco.md", "puck")
VERBS = {"train", "adapt", "report", "render", "export"}


@pytest.fixture
def puck(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return GUIDE.imported(tmp_path, monkeypatch)


@pytest.mark.parametrize("name", ["family", "unknown"])
def test_it_is_moved_by_the_batched_engine(puck: ModuleType, name: str) -> None:
    family = getattr(puck, name)
    world = make_world(family.make_env(), family.task_set("training"))
    assert isinstance(world, HostWorld)
    assert len({family.task_set(which).digest() for which in NAMED_SETS[:3]}) == 3


def test_its_rewards_are_those_that_it_says(puck: ModuleType) -> None:
    goal = jnp.array([0.6, 0.8])
    near, far = ({"qpos": jnp.asarray(at), "qvel": jnp.zeros(2)} for at in ([0.6, 0.6], [0.0, 0.0]))
    rewards = {
        kind: [puck.Puck(reward_kind=kind).reward(far, goal, at, goal).total for at in (near, far)]
        for kind in ("dense", "sparse")
    }
    np.testing.assert_allclose(rewards["dense"], [-0.2, -1.0], atol=1e-6)
    np.testing.assert_allclose(rewards["sparse"], [-0.2, -1.0], atol=1e-6)
    beyond = {"qpos": jnp.array([-0.6, -0.8]), "qvel": jnp.zeros(2)}
    assert puck.Puck(reward_kind="sparse").reward(far, goal, beyond, goal).total == -1
    assert puck.Puck().reward(far, goal, beyond, goal).total == pytest.approx(-2)


def test_masses_friction_and_motors_move_the_puck_as_they_should(puck: ModuleType) -> None:
    """MuJoCo's Euler method takes damping implicitly: m (v' - v) / h = gear u - damping v'."""
    tasks = TaskSet(puck.draw_settings(np.random.default_rng(0), 6))
    env = puck.UnknownPuck()
    start = jax.vmap(env.start)(jax.random.split(jax.random.key(0), 6), tasks.tasks)
    stepper, running = open_stepper(env, num_threads=2), np.zeros(6, bool)
    readings = stepper.begin(start, tasks.tasks)
    control, period = np.array([[1.0, -0.5]]).repeat(6, axis=0), 0.01
    mass, damping, gear = (
        np.float64(getattr(tasks.tasks, name))[:, None] for name in ("mass", "damping", "gear")
    )
    place, speed = readings["qpos"], readings["qvel"]
    for _ in range(4):
        readings = stepper.step(control, running)
        for _ in range(env.frame_skip):
            speed = (mass * speed + period * gear * control) / (mass + period * damping)
            place = place + period * speed
        np.testing.assert_allclose(readings["qvel"], speed, rtol=2e-7)  # in single precision
        np.testing.assert_allclose(readings["qpos"], place, rtol=2e-7)
    stepper.close()
    assert len(np.unique(readings["qvel"][:, 0].round(3))) == 6  # so that they really differ


@pytest.mark.long
@pytest.mark.usefixtures("puck", "figures_unsaved")
def test_its_commands_do_what_they_say() -> None:
    assert GUIDE.verbs == VERBS
    GUIDE.follow(*(VERBS if can_draw() else VERBS - {"render"}))
    for name in ("puck", "unknown"):
        assert list(Path(f"runs/{name}/adaptation").glob("test-sparse*.csv"))
    assert Path("runs/puck/figures/exploration-test-sparse.png").exists()
