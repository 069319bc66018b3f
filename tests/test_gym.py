"""Single Gymnasium environments: Gymnasium's own checker, and the library's worlds bit for bit."""

import collections
import math
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from carts import RUNAWAY, CartTask, cart_on
from gymnasium.utils.env_checker import check_env
from jaxtyping import Array, Float
from learning_problems.probes import hidden_end
from pictures import can_draw, drawn
from playing import agents

from maesn.envs import Point, Reward, TaskFamily, Wheeled, point, wheeled
from maesn.experience.agent import TrialState
from maesn.gym import IDS, TaskEnv
from maesn.numerics import DiagonalGaussian
from maesn.runs.probing import probe_actuators
from maesn.storage import RunError
from maesn.worlds import Actors, Decision, EpisodeError, Start, make_world

# Positions and velocities have no bounds, which the checker merely finds worth a remark.
UNBOUNDED = r"ignore:.*A Box observation space m\w+ value is -?infinity"
STEPS = 12


def play(env: gymnasium.Env[Any, Any], seed: int, steps: int = STEPS) -> list[Any]:
    """All that an environment returns, under random actions that follow from the seed."""
    env.action_space.seed(seed)
    results: list[Any] = [env.reset(seed=seed)]
    return results + [env.step(env.action_space.sample()) for _ in range(steps)]


def test_ids_stay_as_they_are() -> None:
    names = "Wheeled Ant BlockPush Point SparsePoint GridNavi CheetahVel CheetahDir CheetahBody"
    names += " AntDir AntGoal SparseAntGoal"
    assert set(IDS.values()) == {f"maesn/{name}-v0" for name in names.split()}


@pytest.mark.filterwarnings(UNBOUNDED)
@pytest.mark.parametrize("name", IDS.values())
def test_gymnasiums_own_checker_finds_nothing(name: str) -> None:
    env = gymnasium.make(
        f"maesn.gym:{name}", reward="sparse", render_mode="rgb_array" if can_draw() else None
    )
    # What is said on a machine that has nothing to draw with is checked below.
    check_env(env.unwrapped, skip_render_check=not can_draw())
    env.close()
    env.close()


@pytest.mark.parametrize("family", IDS)
def test_states_and_rewards_are_those_of_the_librarys_worlds(family: str) -> None:
    env = TaskEnv(family, task=1, reward="sparse", tasks="test")
    env.reset(seed=5)
    inner: Any = replace(env._inner, horizon=STEPS)
    tasks, first = env.tasks, env._readings
    rng = np.random.default_rng(0)
    if inner.action_kind == "discrete":
        asked = rng.integers(inner.action_size, size=inner.horizon)
        action = np.eye(inner.action_size, dtype=np.float32)[asked]
    else:
        asked = action = rng.uniform(-1.2, 1.2, (inner.horizon, inner.action_size)).astype(
            np.float32
        )
    steps, states = [], [first]
    for row in asked:
        steps.append(env.step(row))
        states.append(env._readings)

    def act(actors: Actors, moment: Any) -> Decision:
        now = jnp.asarray(action)[moment.step]
        spread = DiagonalGaussian(now[None, None], jnp.zeros_like(now)[None, None])
        ended = jnp.zeros((1, 1), bool)
        return Decision(inner.control(now)[None], now[None, None], spread, None, ended)

    task = jax.tree.map(jnp.asarray, tasks[1])

    @jax.jit
    def judged(before: Any, row: jax.Array, after: Any) -> Any:
        instructed = jnp.concatenate([inner.observe(after), inner.instruction(task)])
        return instructed, inner.reward(before, row, after, task), inner.solved(after, task)

    none, row = jnp.zeros((1, 1, 2)), jax.tree.map(lambda x: x[None], task)
    noise = jnp.zeros((inner.horizon, 1, 1, inner.action_size))
    memory = TrialState(None, jnp.zeros((1, 1, inner.action_size)), jnp.zeros((1, 1)))
    actors = Actors(agents(inner, 1), row, none, none, none, noise, memory)
    fields = {name: x[None] for name, x in inner.model_fields(task).items()}
    start = Start(jnp.asarray(first["qpos"]), jnp.asarray(first["qvel"]), fields)
    readings = make_world(inner, tasks).play(act, actors, start).readings
    for step, (observation, reward, _, _, information) in enumerate(steps):
        before, after = (jax.tree.map(lambda x, t=t: np.asarray(x)[t, 0], readings)
                         for t in (step, step + 1))  # fmt: skip
        for name, value in states[step + 1].items():  # bit for bit
            np.testing.assert_array_equal(value[0], after[name])
        instructed, expected, solved = judged(before, action[step], after)
        np.testing.assert_allclose(observation, instructed, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(reward, expected.goal + expected.other, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(information["goal_reward"], expected.goal, rtol=1e-5, atol=1e-6)
        assert information.get("is_success") == (bool(solved) if inner.defines_success else None)
        assert information["task"] == 1


@pytest.mark.parametrize("family", sorted(IDS.keys() - {"grid_navi"}))
def test_the_action_space_covers_the_actuators_exactly(family: str) -> None:
    env = TaskEnv(family)
    inner, actuators = env._inner, probe_actuators(env._inner)
    for end, limit in ((env.action_space.low, "lower"), (env.action_space.high, "upper")):
        control = np.asarray(inner.control(jnp.asarray(end)))
        np.testing.assert_allclose(control, getattr(actuators, limit), rtol=1e-6)
        # And not a part of it twice: just inside, no actuator is at its limit.
        assert (np.abs(np.asarray(inner.control(jnp.asarray(0.99 * end)))) < np.abs(control)).all()


class Geared(Wheeled):
    """A robot with a control of its own, which its motors limit to 2 in the model alone."""

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return 0.5 + jnp.asarray([3.0, -1.0]) * action


def test_an_action_is_a_share_of_the_range_whatever_the_policy_s_scale() -> None:
    family = TaskFamily("geared", Geared, wheeled.draw_tasks, wheeled.task_names, 0)
    env = TaskEnv(family, task=0)
    to_action, control = env._to_action, Geared().control
    box = np.float32([[-1.0, 1.0], [0.0, 0.25]])
    sent = [np.asarray(control(jnp.asarray(action))) for action in to_action(box)]
    np.testing.assert_allclose(sent, 2.0 * box, rtol=1e-6, atol=1e-6)
    same = TaskEnv("wheeled")._to_action(box)
    np.testing.assert_array_equal(same, box)  # bit for bit what a policy would output


@pytest.mark.parametrize("wrong", [5, -1, 0.5, [0, 1]])
def test_what_is_no_choice_is_refused(wrong: Any) -> None:
    env = TaskEnv("grid_navi", task=0)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="`action` must"):
        env.step(wrong)


def test_a_seed_repeats_everything_and_another_does_not() -> None:
    first, again, other = (play(TaskEnv("point"), seed) for seed in (1, 1, 2))
    jax.tree.map(np.testing.assert_array_equal, first, again)
    assert (first[0][0] != other[0][0]).any()


def test_tasks_are_drawn_or_chosen() -> None:
    env = TaskEnv("point")
    drawn = [env.reset(seed=seed)[1]["task"] for seed in range(40)]
    assert len(set(drawn)) > 20
    assert set(drawn) <= set(range(100))
    assert env.reset(options={"task": 7})[1]["task"] == 7
    fixed = TaskEnv("point", task=4)
    assert [fixed.reset()[1]["task"] for _ in range(3)] == [4, 4, 4]
    assert fixed.reset(options={"task": 9})[1]["task"] == 9


def test_an_end_by_nature_is_a_termination() -> None:
    env = TaskEnv(hidden_end, task=2)
    env.reset(seed=0)
    lifetime = math.ceil(env.tasks[2])
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(lifetime)]
    assert 1 < lifetime < 10  # the horizon, which the next task outlives
    assert ends == [(False, False)] * (lifetime - 1) + [(True, False)]
    with pytest.raises(gymnasium.error.ResetNeeded, match="call `reset`"):
        env.step(env.action_space.sample())
    env.reset(options={"task": 1})
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(10)]
    assert ends == [(False, False)] * 9 + [(False, True)]


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"task": 100}, ValueError, "`task` must be an index from 0 to 99"),
        ({"tasks": "tset"}, RunError, "`tasks` must be one of training"),
        ({"family": "weeled"}, RunError, "Did you mean `wheeled`"),
        ({"sparse_radius": -1.0}, ValueError, "`sparse_radius` must be at least 0"),
        ({"render_mode": "human"}, ValueError, "`render_mode` must be None or 'rgb_array'"),
    ],
)
def test_wrong_settings_are_refused_by_name(
    settings: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        TaskEnv(**{"family": "point"} | settings)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"taks": 3}, "^`options` may hold `task` alone, got taks"),
        ({"task": 100}, "^`task` must be an index from 0 to 99"),
    ],
)
def test_a_wrong_option_of_a_reset_is_refused_and_changes_nothing(
    wrong: dict[str, Any], message: str
) -> None:
    env, other = TaskEnv("point"), TaskEnv("point")
    env.reset(seed=3)
    other.reset(seed=3)
    with pytest.raises(ValueError, match=message):
        env.reset(seed=4, options=wrong)
    assert env.reset(options={})[1] == other.reset()[1]


def test_gymnasium_plays_several_at_once() -> None:
    envs = gymnasium.make_vec("maesn.gym:maesn/Point-v0", num_envs=2, tasks="test")
    observation, _ = envs.reset(seed=3, options={"task": 1})
    for row in range(2):
        expected, _ = TaskEnv("point", tasks="test").reset(seed=3 + row, options={"task": 1})
        np.testing.assert_array_equal(observation[row], expected)
    envs.close()


def test_nothing_is_stepped_or_drawn_before_a_reset() -> None:
    env = TaskEnv("point", render_mode="rgb_array")
    for call in (partial(env.step, np.zeros(2)), env.render):
        with pytest.raises(gymnasium.error.ResetNeeded, match="call `reset` before"):
            call()


@pytest.mark.parametrize("family", ["point", "wheeled"])
def test_actions_that_are_none_are_refused(family: str) -> None:
    env = TaskEnv(family, task=4)
    env.reset(seed=0)
    for action in (0.5, np.zeros(3), np.zeros((1, 2))):
        with pytest.raises(ValueError, match="`action` must have the shape"):
            env.step(action)
    with pytest.raises(EpisodeError, match=rf"{family}, task 4, episode 0, step 0: .*finite"):
        env.step(np.array([0.0, np.nan]))
    env.close()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(2))


class RewardIsNaN(Point):
    """A point whose reward is NaN where it has gone right."""

    def reward(self, readings: Any, action: Any, next_readings: Any, task: Any) -> Reward:
        goal, other = super().reward(readings, action, next_readings, task)
        return Reward(jnp.where(next_readings["qpos"][0] > 0.3, jnp.nan, goal), other)


class Unseeing(Point):
    """A point that sees NaN where it has gone right."""

    def observe(self, readings: Any) -> jax.Array:
        return jnp.where(readings["qpos"][0] > 0.3, jnp.nan, readings["qpos"])


@pytest.mark.parametrize(("env", "what"), [(RewardIsNaN, "reward"), (Unseeing, "observation")])
def test_what_is_no_number_is_an_error_that_says_where(env: Any, what: str) -> None:
    family = point._replace(make_env=env)
    known = TaskEnv("point", task=1)
    places = [known.reset(seed=0)[0]] + [known.step(np.ones(2))[0] for _ in range(20)]
    first = int(np.argmax([place[0] > 0.3 for place in places])) - 1
    assert first > 0
    broken = TaskEnv(family, task=1)
    broken.reset(seed=0)
    for _ in range(first):
        broken.step(np.ones(2))
    where = f"point, task 1, episode 0, step {first}: the {what} is not finite"
    with pytest.raises(EpisodeError, match=where):
        broken.step(np.ones(2))


def family_on_rails(directory: Path, actuator: str) -> TaskFamily:
    cart = cart_on(directory, actuator)
    tasks = CartTask(np.ones(5, np.float32), np.arange(1.0, 6.0, dtype=np.float32))

    def draw(_: np.random.Generator, size: int) -> CartTask:
        return CartTask(*(np.resize(values, size) for values in tasks))

    return TaskFamily("cart", lambda **_: cart(force=3.0), draw, ("speed", "mass"), 0)


def test_physics_that_blows_up_is_an_error_that_says_where(tmp_path: Path) -> None:
    env = TaskEnv(family_on_rails(tmp_path, RUNAWAY), task=0)
    assert any(env.reset(seed=seed)[0][1] > 0 for seed in range(50))  # this one is pushed
    with pytest.raises(EpisodeError, match=r"cart, task 0, episode 0, step \d+: "):
        collections.deque((env.step(np.zeros(1)) for _ in range(12)), maxlen=0)


@pytest.mark.parametrize("name", IDS.values())
def test_pictures_or_one_sentence(name: str) -> None:
    env = gymnasium.make(name, reward="sparse", render_mode="rgb_array")
    env.reset(seed=0, options={"task": 0})
    first = drawn(env.render)
    if first is None:
        return
    assert first.shape == (360, 480, 3)
    assert first.dtype == np.uint8
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 100
    np.testing.assert_array_equal(env.render(), first)
    env.reset(options={"task": 1})
    assert (env.render() != first).any()
    env.close()


def test_without_a_render_mode_there_is_no_picture() -> None:
    env = TaskEnv("point")
    env.reset()
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert env.render() is None


def test_without_gymnasium_one_sentence_says_what_to_install() -> None:
    program = "import sys; sys.modules['gymnasium'] = None; import maesn.gym"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.stderr.splitlines()[-1] == (
        "ImportError: `maesn.gym` needs Gymnasium: pip install -e '.[gym]' in its clone"
    )
