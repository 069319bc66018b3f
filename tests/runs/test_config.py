"""What `config.json` says: believed if it is ours, never executed."""

import json
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from small_runs import create_tiny, tiny_maesn, tiny_settings

from maesn.context import LatentContext
from maesn.envs import FAMILIES, Point, Reward, TaskFamily, Wheeled
from maesn.runs.run import Run
from maesn.serialization import digest_of_document
from maesn.storage import RunError
from maesn.worlds import check_env_contract

POINT = FAMILIES["point"]


def edit(directory: Path, **changes: Any) -> None:
    """Change `config.json` and its digest: what a forger does."""
    path = directory / "config.json"
    document = json.loads(path.read_text()) | changes
    kept = {name: value for name, value in document.items() if value != "drop"}
    del kept["digest"]
    path.write_text(json.dumps(kept | {"digest": digest_of_document(kept)}))


def paths_of(document: Any, *path: str) -> Iterator[tuple[str, ...]]:
    """The path of every value of a JSON document that is neither an object nor empty."""
    if isinstance(document, dict) and document:
        for name, value in document.items():
            yield from paths_of(value, *path, name)
    else:
        yield path


def test_any_value_that_was_changed_by_hand_is_noticed(directory: Path) -> None:
    file = directory / "config.json"
    original = json.loads(file.read_text())
    file.write_text(json.dumps(original))  # written otherwise, it says the same
    Run.open(directory)
    paths = set(paths_of(original))
    assert {("settings", "seed"), ("settings", "reward"), ("versions", "jax")} < paths
    for *parents, last in paths - {("schema",)}:
        document = json.loads(file.read_text())
        inner = document
        for parent in parents:
            inner = inner[parent]
        inner[last] = {"another": 1}
        assert_is_changed(directory, json.dumps(document))
        file.write_text(json.dumps(original))
    Run.open(directory)
    del original["digest"]
    assert_is_changed(directory, json.dumps(original))


def assert_is_changed(directory: Path, text: str) -> None:
    (directory / "config.json").write_text(text)
    with pytest.raises(RunError, match=r"config.json` was changed"):
        Run.open(directory)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"schema": 1}, "schema"),
        ({"schema": "drop"}, "schema"),
        ({"learner": "drop"}, "learner"),
        ({"learner": {"type": "Trojan"}}, "Trojan"),
        ({"learner": {"type": "NoContext"}}, "MetaLearner, got .NoContext"),
        ({"settings": []}, "RunConfig.settings"),
        ({"settings": {"engine": "mjx"}}, "was trained on MJX"),
        ({"versions": {"jax": 1}}, "RunConfig.versions.jax"),
        ({"changes": [{"iteration": 1}]}, "changed"),
        ({"surprise": 1}, "surprise"),
        ({"family": "points"}, "points"),
        ({"task_digest": "0123"}, "point"),
    ],
)
def test_a_configuration_that_is_not_ours_is_refused_by_name(
    directory: Path, changes: dict[str, Any], named: str
) -> None:
    edit(directory, **changes)
    with pytest.raises(RunError, match=named):
        Run.open(directory)


def test_numbers_that_are_not_finite_are_no_settings(tmp_path: Path) -> None:
    learner = tiny_maesn(context=LatentContext(kl_weight=float("inf")))
    with pytest.raises(RunError, match="must hold finite numbers"):
        Run.create(tmp_path / "run", learner, tiny_settings())


MODULE = """
from maesn.envs import FAMILIES
own = FAMILIES["point"]._replace(name="own", seed=77)
other = own._replace(name="other")
reseeded = own._replace(seed=78)
number = 3
"""


@pytest.fixture
def own_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Name of a module with a user's own family."""
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "own_families.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path / "modules"))
    yield "own_families"
    sys.modules.pop("own_families", None)


def test_a_family_of_ones_own_is_given_again(tmp_path: Path, own_module: str) -> None:
    made = create_tiny(tmp_path / "run", family=f"{own_module}:own")
    assert made.family.name == "own"
    # A fresh start: whatever opens the run now must not import what the file names.
    del sys.modules[own_module]
    with pytest.raises(RunError, match=f"{own_module}:own"):
        Run.open(tmp_path / "run")
    assert own_module not in sys.modules
    opened = Run.open(tmp_path / "run", family=f"{own_module}:own")
    assert opened.training_tasks.digest() == made.training_tasks.digest()
    assert Run.open(tmp_path / "run", family=made.family).family is made.family
    with pytest.raises(RunError, match="family is `own`, but `other` was given"):
        Run.open(tmp_path / "run", family=f"{own_module}:other")
    with pytest.raises(RunError, match="family is `own`, but `point` was given"):
        Run.open(tmp_path / "run", family="point")
    with pytest.raises(RunError, match="on other tasks than `training` of the family `own` now"):
        Run.open(tmp_path / "run", family=f"{own_module}:reseeded")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nowhere:own", "nowhere"),
        ("own_families:missing", "missing"),
        ("own_families:number", "TaskFamily"),
    ],
)
def test_an_unknown_family(tmp_path: Path, own_module: str, name: str, said: str) -> None:
    with pytest.raises(RunError, match=said):
        create_tiny(tmp_path / "run", family=name)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("tasks", [[0.0] * 100, [{"x": 1.0}] * 100, np.zeros(99), np.array(["a"])])
def test_tasks_must_be_arrays_with_a_row_for_each(tmp_path: Path, tasks: Any) -> None:
    family: TaskFamily = POINT._replace(name="odd", draw_tasks=lambda stream, size: tasks)
    with pytest.raises(RunError, match="`draw_tasks` of `odd` must return an array of numbers"):
        Run.create(tmp_path / "run", tiny_maesn(), tiny_settings(), family)


def test_tests_that_are_trained_on_are_warned_of(tmp_path: Path) -> None:
    goals = POINT.task_set("training").tasks
    family: TaskFamily = POINT._replace(name="fixed", draw_tasks=lambda stream, size: goals[:size])
    with pytest.warns(UserWarning, match="test tasks of `fixed` are those that are trained on"):
        Run.create(tmp_path / "run", tiny_maesn(), tiny_settings(), family)


def with_method(kind: Any, **methods: Any) -> Any:
    """An environment with other functions: `self` and all arguments are theirs."""
    return type(kind.__name__, (kind,), methods)


# What must agree with the rest of the environment, and an environment in which it does not.
CONTRADICTIONS = [
    (
        "advance",
        with_method(Point, advance=lambda self, readings, control: {"qpos": readings["qpos"]}),
    ),
    ("initial", with_method(Wheeled, initial=lambda self, key, task: (jnp.zeros(6), jnp.zeros(5)))),
    ("model_fields", with_method(Wheeled, model_fields=lambda self, task: {"body_mass": 1.0})),
    (
        "model_fields",
        with_method(Wheeled, model_fields=lambda self, task: {"body_weight": jnp.ones(5)}),
    ),
    ("readings", with_method(Wheeled, readings=("qpos", "qvel", "xspeed"))),
    ("control", with_method(Wheeled, control=lambda self, action: jnp.zeros(3))),
    ("model_fields", with_method(Point, model_fields=lambda self, task: {"mass": jnp.ones(1)})),
    (
        "action_size",
        partial(with_method(Wheeled, control=lambda self, action: 2 * action), action_size=3),
    ),
    ("control_period", with_method(Wheeled, control_period=0.02)),
    ("instruction", with_method(Point, instruction=lambda self, task: jnp.zeros(()))),
    ("observe", with_method(Point, observe=lambda self, readings: readings["qpos"][:1])),
    ("reward", with_method(Point, reward=lambda self, *_: Reward(jnp.zeros(1), jnp.zeros(())))),
    ("terminated", with_method(Point, terminated=lambda self, readings: readings["qpos"] > 0)),
    ("truncated", with_method(Point, truncated=lambda self, readings: readings["qpos"] > 0)),
    ("solved", with_method(Point, solved=lambda self, readings, task: readings["qpos"] > 0)),
    ("goal", with_method(Point, goal=lambda self, task: jnp.zeros(3))),
]


@pytest.mark.parametrize(("name", "make_env"), CONTRADICTIONS)
def test_an_environment_that_contradicts_itself_is_refused(
    name: str, make_env: Any, tmp_path: Path
) -> None:
    family: TaskFamily = POINT._replace(name="odd", make_env=make_env)
    with pytest.raises(RunError, match=f"`{name}` must"):
        Run.create(tmp_path / "run", tiny_maesn(), tiny_settings(), family)
    assert not (tmp_path / "run").exists()


def test_a_model_with_an_error_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    path.write_text("<mujoco><worldbody><geom typ='box'/></worldbody></mujoco>")
    odd = POINT._replace(name="odd", make_env=with_method(Wheeled, model=str(path)))
    with pytest.raises(RunError, match="unrecognized attribute: 'typ'") as refused:
        Run.create(tmp_path / "run", tiny_maesn(), tiny_settings(), odd)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES)
def test_the_librarys_own_environments_keep_their_word(family: TaskFamily) -> None:
    for variant in family.make_env().variants:
        check_env_contract(family.make_env(variant=variant), family.task_set("test")[0])


def test_what_a_function_raises_is_not_hidden(tmp_path: Path) -> None:
    broken = with_method(Point, observe=lambda self, readings: jnp.ones(2) @ jnp.ones(3))
    with pytest.raises(TypeError, match="contracting"):
        Run.create(tmp_path / "run", tiny_maesn(), tiny_settings(), POINT._replace(make_env=broken))


def test_a_name_that_stands_twice_changes_nothing(directory: Path) -> None:
    """JSON readers differ in which one counts; here it is the one that the digest is of."""
    path, before = directory / "config.json", Run.open(directory).config
    text = path.read_text()
    path.write_text(text.replace('"seed": 0', '"seed": 5, "seed": 0'))
    assert Run.open(directory).config == before
    assert_is_changed(directory, text.replace('"seed": 0', '"seed": 0, "seed": 5'))
