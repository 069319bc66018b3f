"""Families of foreign environments: what is read off them, what is mapped, what is refused."""

import ast
import re
import subprocess
import sys
import threading
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import ClipAction, RescaleAction, TimeLimit, TransformAction
from pictures import can_draw
from scripts import ROOT
from strange_families import is_running, walkers
from strangers import (
    Arm,
    Diarist,
    Plain,
    Skip,
    Warm,
    draw_walks,
    make_hopeless,
    make_walker,
)

from maesn.envs.foreign import gymnasium_family
from maesn.envs.hosted import task_row
from maesn.foreign import InterfaceError
from maesn.runs.probing import probe_actuators
from maesn.worlds import EnvContractError, check_env_contract, make_world


def family_of(env: Any, **settings: Any) -> Any:
    return gymnasium_family("plain", lambda task, reward: env, draw_walks, **settings)


BOX = spaces.Box(-1, 1, (2,))


def test_actions_are_mapped_to_the_range_of_the_action_space() -> None:
    env = walkers.make_env()
    actions = jnp.array([[0.0, 0.0], [1.0, 1.0], [-1.0, -1.0], [0.5, 0.5], [9.0, -9.0]])
    wanted = [[0, 0.25], [1, 0.5], [-1, 0], [0.5, 0.375], [1, 0]]
    np.testing.assert_allclose(jax.vmap(env.control)(actions), wanted, atol=1e-7)
    # The runtime takes the map over as numbers.
    actuators = probe_actuators(env)
    np.testing.assert_allclose(actuators.offset, [0, 0.25], atol=1e-6)
    np.testing.assert_allclose(actuators.scale, [1, 0.25], atol=1e-6)
    np.testing.assert_allclose(actuators.lower, [-1, 0])
    np.testing.assert_allclose(actuators.upper, [1, 0.5])


LIMITS = [[-0.2, -0.4], [0.2, 0.8]]
# What is made of the arm -> limits, period, and steps of an episode; 7 if there is no clock.
SEEN: dict[str, tuple[Any, Any, float, int]] = {
    "itself": (lambda arm: arm, LIMITS, 0.05, 7),
    "a frame skip": (lambda arm: Skip(TimeLimit(arm, 10), 4), LIMITS, 0.2, 3),
    "a clock around a frame skip": (lambda arm: TimeLimit(Skip(arm, 2), 10), LIMITS, 0.1, 10),
    "warmed up": (lambda arm: TimeLimit(Warm(arm), 10), LIMITS, 0.05, 10),
    "clipped": (lambda arm: TimeLimit(ClipAction(arm), 10), LIMITS, 0.05, 10),
    "rescaled": (
        lambda arm: TimeLimit(RescaleAction(arm, np.float32(-1), np.float32(1)), 10),
        [[-1, -1], [1, 1]],
        0.05,
        10,
    ),
}


@pytest.mark.parametrize("how", SEEN)
def test_limits_and_times_are_those_under_which_a_policy_is_trained(how: str) -> None:
    wrap, limits, period, steps = SEEN[how]
    horizon = 7 if steps == 7 else None
    env = family_of(wrap(Arm(0.05, 20)), horizon=horizon).make_env()
    assert env.control_period == pytest.approx(period)
    assert env.horizon == steps
    actuators = probe_actuators(env)
    np.testing.assert_allclose([actuators.lower, actuators.upper], limits, atol=1e-5)


UNKNOWN = {
    "it has neither `dt` nor `render_fps`": lambda: Arm(None, None),
    "its `dt` is 0.01 s, but its `metadata` shows 20 steps a second": lambda: Arm(0.01, 20),
    "its wrappers may repeat actions, more or less often": lambda: Skip(Arm(0.05, 20), 1, 2),
}


@pytest.mark.parametrize("reason", UNKNOWN)
def test_a_period_that_cannot_be_derived_is_asked_for(reason: str) -> None:
    env = UNKNOWN[reason]()
    with pytest.raises(InterfaceError, match=rf"`control_period` must be given .* {reason}"):
        family_of(env, horizon=3).make_env()
    assert family_of(env, horizon=3, control_period=0.5).make_env().control_period == 0.5


@pytest.mark.parametrize(
    ("arm", "period"), [(Arm(0.015, 67), 0.015), (Arm(None, 40), 0.025), (Arm(0.3, None), 0.3)]
)
def test_a_rounded_rate_does_not_blur_a_period(arm: Arm, period: float) -> None:
    assert family_of(arm, horizon=3).make_env().control_period == pytest.approx(period)


def test_tasks_of_one_situation_share_episodes_if_the_reward_is_known() -> None:
    def reward(seen: Any, control: Any, after: Any, task: Any, kind: str) -> Any:
        return -jnp.linalg.norm(after[-2:] - task[:2])

    with pytest.raises(ValueError, match="`situation` of `walker` needs `reward`"):
        gymnasium_family("walker", make_walker, draw_walks, situation=lambda task: ())
    known = partial(gymnasium_family, "walker", make_walker, draw_walks, horizon=3)
    family = known(situation=lambda task: task[2:], reward=reward)
    env, task = family.make_env(), family.task_set("test")[0]
    np.testing.assert_array_equal(env.situation(task), task[2:])
    check_env_contract(env, task)
    readings = {"observation": jnp.zeros(10), "reward": jnp.zeros(())}
    found = env.reward(readings, jnp.zeros(2), readings, jnp.array([3.0, 4.0, 0.0, 0.0]))
    assert found.total == pytest.approx(-5.0)
    wrong = known(reward=lambda *_: jnp.ones(())).make_env()
    with pytest.raises(EnvContractError, match="`reward` must be the environment's own"):
        check_env_contract(wrong, task)


def test_figures_get_positions_where_the_family_has_them() -> None:
    family = gymnasium_family(
        "walker",
        make_walker,
        draw_walks,
        horizon=2,
        position=lambda observation: observation[-2:],
        goal=lambda task: task[:2],
        defines_success=False,
    )
    env = family.make_env()
    assert env.planar
    assert not env.defines_success
    assert env.observation_names()[0] == "observation[0]"
    assert len(env.observation_names()) == env.observation_size
    np.testing.assert_array_equal(env.position(jnp.arange(10.0)), [8, 9])
    np.testing.assert_array_equal(env.goal(jnp.arange(4.0)), [0, 1])


def test_the_environment_is_looked_at_once_and_closed(tmp_path: Path) -> None:
    diary = tmp_path / "diary"
    family = gymnasium_family("diarist", partial(Diarist, diary), draw_walks, horizon=2)
    assert not diary.exists()
    assert family.make_env() == family.make_env()
    assert family.make_env(reward_kind="sparse") != family.make_env()
    # That closing it raises is of no concern any more.
    made, closed = diary.read_text().splitlines()
    assert re.fullmatch(r"made in \d+, dense", made)
    assert closed == "closed"


def test_tasks_are_handed_over_as_arrays_of_single_precision() -> None:
    task = task_row({"a": np.arange(6.0).reshape(2, 3), "b": np.array([7, 8])}, 1)
    assert isinstance(task["a"], np.ndarray)
    assert task["a"].dtype == np.float32
    np.testing.assert_array_equal(task["a"], [3, 4, 5])
    assert task["b"] == 8

    def make(task: np.ndarray, reward: str) -> Any:
        assert task.dtype == np.float32
        return make_walker(task, reward)

    family = gymnasium_family("walker", make, lambda _, size: np.ones((size, 4)), horizon=2)
    check_env_contract(family.make_env(), family.task_set("test")[0])


REFUSED = {
    "component 1 reaches from -1.0 to inf: give it finite bounds": Plain(
        BOX, spaces.Box(-1, np.float32([1, np.inf]))
    ),
    "component 1 reaches from -1.0 to 3.4028": Plain(
        BOX, spaces.Box(-1, np.float32([1, np.finfo(np.float32).max]))
    ),
    "component 0 reaches from -1e+300 to 1e+300": Plain(
        BOX, spaces.Box(-1e300, 1e300, (1,), np.float64)
    ),
    "component 1 of the action space can only be 1.0: leave it out": Plain(
        BOX, spaces.Box(np.float32([-1, 1]), np.float32([1, 1]))
    ),
    "must be a bounded `Box` of floating-point numbers or `Discrete`, got MultiDiscrete": Plain(
        BOX, spaces.MultiDiscrete([2, 3])
    ),
    "floating-point numbers or `Discrete`, got MultiDiscrete": TimeLimit(
        Plain(BOX, spaces.MultiDiscrete([2, 3])), 5
    ),
    "the observation space must be a `Box`": Plain(spaces.Discrete(3), BOX),
    "`horizon` must be given for `plain`": Plain(BOX, BOX),
}


@pytest.mark.parametrize("reason", REFUSED)
def test_what_cannot_be_learned_in_is_refused_by_name(reason: str) -> None:
    with pytest.raises(ValueError, match=re.escape(reason)) as error:
        family_of(REFUSED[reason], control_period=0.1).make_env()
    assert "`plain`" in str(error.value)


def test_an_action_space_without_bounds_can_be_given_some() -> None:
    arm = Arm(0.05, 20)
    arm.action_space = spaces.Box(-np.inf, np.inf, (2,))
    bounded = TransformAction(arm, lambda action: action, BOX)
    assert family_of(bounded, horizon=2).make_env().interface.upper == (1.0, 1.0)
    with pytest.raises(InterfaceError, match="the action space must be bounded"):
        family_of(ClipAction(arm), horizon=2).make_env()


HOPELESS = {
    "raises": "`make_env` raised OSError: no licence (",
    "returns nothing": "`make_env` must return a `gymnasium.Env`, got None",
    "has no spaces": "the environment raised AttributeError: ",
    "hangs": "the environment has not returned within `time_limit`, 1 s",
    "exits": "the environment has ended its process (exit code 3)",
    "quits": "the environment has ended its process (exit code 4)",
}


@pytest.mark.parametrize("how", HOPELESS)
def test_an_environment_that_cannot_be_looked_at_is_named_and_leaves_no_process_behind(
    how: str, tmp_path: Path
) -> None:
    diary = tmp_path / "diary"
    make_env = partial(make_hopeless, how, diary)
    family = gymnasium_family("hopeless", make_env, draw_walks, horizon=2, time_limit=1.0)
    with pytest.raises(InterfaceError) as error:
        family.make_env()
    assert str(error.value).startswith(f"`hopeless`, task 0: {HOPELESS[how]}")
    assert not is_running(int(diary.read_text()))


def test_an_environment_that_cannot_be_sent_to_a_process_is_refused() -> None:
    lock = threading.Lock()
    reason = r"`plain`, task 0: `make_env` cannot be sent to a process: TypeError: cannot pickle"
    with pytest.raises(InterfaceError, match=reason):
        family_of(lock).make_env()


def test_settings_without_a_meaning_are_refused() -> None:
    for settings in ({"variant": "paper"}, {"sparse_radius": 0.5}):
        with pytest.raises(ValueError, match="have no meaning in `stranger`"):
            walkers.make_env(**settings)


def modules_after(statement: str) -> set[str]:
    program = f"import sys\n{statement}\nprint(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_a_foreign_family_needs_no_engine_of_ours_and_ours_need_no_gymnasium() -> None:
    assert "mujoco.batch" not in modules_after("import maesn.envs.foreign, maesn.worlds.foreign")
    assert "gymnasium" not in modules_after("import maesn.envs, maesn.worlds, maesn.api")


def test_a_worker_needs_numpy_alone() -> None:
    """It runs in the interpreter of the environments, where nothing of ours is installed."""
    file = ROOT / "src/maesn/foreign/worker.py"
    packages: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            packages |= {alias.name.split(".")[0] for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            packages.add(str(node.module).split(".")[0])
    assert packages - sys.stdlib_module_names == {"numpy"}


def test_the_extra_brings_what_gymnasiums_own_robots_import(tmp_path: Path) -> None:
    family = gymnasium_family(
        "cheetah",
        lambda task, reward: gymnasium.make("HalfCheetah-v5", render_mode="rgb_array"),
        draw_walks,
    )
    env = family.make_env()
    assert (env.observation_size, env.action_size, env.horizon) == (17, 6, 1000)
    assert env.control_period == pytest.approx(0.05)
    if not can_draw():
        return
    # Without a screen, and without the variable that says so.
    with closing(make_world(env, family.task_set("test", 1), num_threads=1)) as world:
        assert world.film(1, 500, (30, 20))
        tasks = family.task_set("test", 1)
        renderer = world.stepper.renderer(tasks[0])
        world.stepper.begin(jnp.zeros(1, jnp.uint32), tasks.tasks)
        assert renderer is not None
        (picture,) = renderer(1)
    assert picture.shape == (480, 480, 3)
    assert picture.std() > 0
