"""Families of foreign environments: what is read off them, what is mapped, what is refused."""

import ast
import re
import subprocess
import sys
import threading
import tomllib
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import TransformAction
from scripts import ROOT
from strange_families import is_running, walkers
from strangers import Chooser, Diarist, Plain, draw_walks, make_hopeless, make_walker

from maesn.envs.foreign import gymnasium_family, task_row
from maesn.foreign import InterfaceError
from maesn.runs.export import probe_actuators


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


def test_sizes_and_times_are_read_off_the_environment() -> None:
    family = gymnasium_family(
        "pendulum", lambda task, reward: gymnasium.make("Pendulum-v1"), draw_walks
    )
    env = family.make_env(reward_kind="sparse")
    assert (env.observation_size, env.action_size, env.action_kind) == (3, 1, "continuous")
    assert env.horizon == 200  # the `max_episode_steps` that Gymnasium registers it with
    assert env.control_period == pytest.approx(1 / 30)
    assert env.reward_kind == "sparse"
    assert not env.planar
    np.testing.assert_allclose(env.control(jnp.array([0.5])), [1.0])  # torques of +-2
    walker = walkers.make_env()
    assert (walker.observation_size, walker.horizon, walker.control_period) == (10, 6, 0.1)


def test_choices_are_discrete_actions() -> None:
    env = family_of(Chooser(np.zeros(1)), horizon=3, control_period=1.0).make_env()
    assert (env.action_kind, env.action_size) == ("discrete", 3)


def test_figures_get_positions_where_the_family_has_them() -> None:
    family = gymnasium_family(
        "walker",
        make_walker,
        draw_walks,
        horizon=2,
        position=lambda observation: observation[-2:],
        goal=lambda task: task[:2],
    )
    env = family.make_env()
    assert env.planar
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


def test_the_first_look_is_at_the_first_task_of_training() -> None:
    first = walkers.task_set("training")[0]

    def make(task: np.ndarray, reward: str) -> Any:
        assert task.tolist() == first.tolist()
        return make_walker(task, reward)

    gymnasium_family("walker", make, draw_walks, horizon=2).make_env()


def test_tasks_are_handed_over_as_arrays_of_single_precision() -> None:
    task = task_row({"a": np.arange(6.0).reshape(2, 3), "b": np.array([7, 8])}, 1)
    assert isinstance(task["a"], np.ndarray)
    assert task["a"].dtype == np.float32
    np.testing.assert_array_equal(task["a"], [3, 4, 5])
    assert task["b"] == 8


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
    "must flatten to a vector of fixed length": Plain(spaces.Sequence(BOX), BOX),
    "`horizon` must be given for `plain`": Plain(BOX, BOX),
}


@pytest.mark.parametrize("reason", REFUSED)
def test_what_cannot_be_learned_in_is_refused_by_name(reason: str) -> None:
    with pytest.raises(ValueError, match=re.escape(reason)) as error:
        family_of(REFUSED[reason], control_period=0.1).make_env()
    assert "`plain`" in str(error.value)


def test_an_action_space_without_bounds_can_be_given_some() -> None:
    unbounded = Plain(BOX, spaces.Box(-np.inf, np.inf, (2,)))
    bounded = TransformAction(unbounded, lambda action: action, BOX)
    assert family_of(bounded, horizon=2, control_period=1.0).make_env().action_size == 2


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


def test_a_foreign_family_needs_no_engine_of_ours_and_ours_need_no_gymnasium_and_no_mjx() -> None:
    assert "mujoco.batch" not in modules_after("import maesn.envs.foreign, maesn.worlds.foreign")
    loaded = modules_after("import maesn.envs, maesn.worlds, maesn.api")
    assert not {"gymnasium", "mujoco.mjx"} & loaded


def imported_packages(file: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    return {name.split(".")[0] for name in names}


def test_the_installation_declares_what_hosting_imports() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = project["dependencies"] + project["optional-dependencies"]["gym"]
    files = (ROOT / "src/maesn/foreign").glob("*.py")
    imported = set().union(*map(imported_packages, files)) - sys.stdlib_module_names - {"maesn"}
    assert "gymnasium" in imported
    distributions = {{"PIL": "pillow"}.get(package, package) for package in imported}
    assert distributions <= {re.split(r"[\[<>=]", requirement)[0] for requirement in declared}


def test_a_worker_starts_without_jax() -> None:
    assert not {"jax", "mujoco"} & modules_after("import maesn.foreign.worker")
