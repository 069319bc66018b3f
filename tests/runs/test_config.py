"""What `config.json` says: believed if it is ours, never executed."""

import json
import re
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from small_runs import create_tiny, tiny_maesn, tiny_settings

from maesn.context import LatentContext
from maesn.envs import FAMILIES, Point, Reward, TaskFamily, Wheeled
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.runs.serialization import digest_of_document
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
        file.write_text(json.dumps(document))
        with pytest.raises(RunError, match=r"config.json` was changed since maesn wrote it"):
            Run.open(directory)
        file.write_text(json.dumps(original))
    Run.open(directory)


def test_a_forged_configuration_does_not_fit_the_checkpoints(directory: Path) -> None:
    settings = json.loads((directory / "config.json").read_text())["settings"]
    edit(directory, settings=settings | {"seed": 7})
    with pytest.raises(RunError, match=r"with another `config.json`"):
        Run.open(directory).latest()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"schema": 1}, "it may be of another version of maesn: its schema must be 2"),
        ({"schema": "drop"}, "its schema must be 2"),
        ({"learner": "drop"}, "`RunConfig` must have the fields .*'learner'"),
        ({"task_digest": "drop"}, "`RunConfig` must have the fields .*'task_digest'"),
        ({"learner": {"type": "Trojan"}}, "got 'Trojan'"),
        (
            {"learner": {"type": "NoContext"}},
            "cannot be understood.*: `type` must name settings of type .*MetaLearner",
        ),
        ({"learner": 3}, "`RunConfig.learner` must be of type .*, got 3"),
        ({"settings": {}}, "`RunSettings` must have the fields"),
        ({"settings": []}, r"`RunConfig.settings` must be of type RunSettings, got \[\]"),
        ({"versions": 1}, "`RunConfig.versions` must be of type .*, got 1"),
        ({"versions": {"jax": 1}}, "`RunConfig.versions.jax` must be of type str, got 1"),
        ({"changes": [{"iteration": 1}]}, "`Change` must have the fields .*'changed'"),
        ({"surprise": 1}, "`RunConfig` must have the fields .* got .*'surprise'"),
        ({"family": "points"}, "give the run's family as `module:name`.*`points`"),
        ({"task_digest": "0123"}, "other tasks than `training` of the family `point` now holds"),
    ],
)
def test_a_configuration_that_is_not_ours(
    directory: Path, changes: dict[str, Any], said: str
) -> None:
    edit(directory, **changes)
    with pytest.raises(RunError, match=said):
        Run.open(directory)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe"])
def test_a_configuration_that_is_no_document(directory: Path, content: bytes) -> None:
    (directory / "config.json").write_bytes(content)
    with pytest.raises(RunError, match=r"Expected a JSON object at .*config.json"):
        Run.open(directory)


def test_settings_that_do_not_fit_the_tasks(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"`meta_batch_size` is 101, .* only 100 tasks"):
        Run.create(tmp_path / "run", tiny_maesn(meta_batch_size=101), tiny_settings())
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["reward", "variant", "engine"])
def test_a_word_that_is_none_of_the_choices_is_refused_at_once(name: str) -> None:
    settings: Any = SimpleNamespace(**vars(RunSettings()) | {name: "spars"})  # no types are checked
    with pytest.raises(ValueError, match=f"`{name}` must be '.*' or '.*', got 'spars'"):
        RunSettings.__post_init__(settings)


def test_numbers_that_are_not_finite_are_no_settings(tmp_path: Path) -> None:
    learner = tiny_maesn(context=LatentContext(kl_weight=float("inf")))
    with pytest.raises(RunError, match="must hold finite numbers"):
        Run.create(tmp_path / "run", learner, tiny_settings())


def test_settings_are_documented_for_the_command_line() -> None:
    # tyro reads the strings under the fields; an option without help text is not acceptable.
    source = Path(sys.modules[RunSettings.__module__].__file__).read_text()
    for name in RunSettings.__dataclass_fields__:
        assert f"    {name}: " in source
        assert source.split(f"\n    {name}: ", 1)[1].splitlines()[1].startswith('    """')


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


def test_a_family_can_be_given_as_an_object(tmp_path: Path) -> None:
    own: TaskFamily = POINT._replace(name="own", seed=77)
    run = Run.create(tmp_path / "run", tiny_maesn(), tiny_settings(), own)
    assert run.settings.family == run.config.family == "own"
    assert Run.open(tmp_path / "run", own).settings == run.settings


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("wheelde", "got `wheelde`. Did you mean `wheeled`"),
        ("nowhere:own", "No module named 'nowhere'"),
        ("own_families:missing", "no attribute 'missing'"),
        ("own_families:number", "must be a TaskFamily, got int"),
        (":own", "`family` is `:own`"),
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


CONTRADICTIONS = {
    "advance` must return the shape {'qpos': (2,), 'qvel': (2,)}, got {'qpos'": with_method(
        Point, advance=lambda self, readings, control: {"qpos": readings["qpos"]}
    ),
    "initial` must return the shape ((6,), (6,)), got ((6,), (5,)).": with_method(
        Wheeled, initial=lambda self, key, task: (jnp.zeros(6), jnp.zeros(5))
    ),
    "model_fields` must return the shape {'body_mass': (5,)}, got {'body_mass': ()}.": with_method(
        Wheeled, model_fields=lambda self, task: {"body_mass": jnp.ones(())}
    ),
    'model_fields` must name fields of `mujoco.MjModel`, or of its options as "opt.<field>", got '
    "'body_weight'.": with_method(
        Wheeled, model_fields=lambda self, task: {"body_weight": jnp.ones(5)}
    ),
    "readings` must name fields of `mujoco.MjData`, got 'xspeed'.": with_method(
        Wheeled, readings=("qpos", "qvel", "xspeed")
    ),
    "control` must return the shape (2,), got (3,).": with_method(
        Wheeled, control=lambda self, action: jnp.zeros(3)
    ),
    "action_size` must be 2, as many as the model has actuators, because `control` makes one "
    "number of each, got 3.": partial(
        with_method(Wheeled, control=lambda self, action: 2 * action), action_size=3
    ),
    "control` must take an action of `action_size` 2 numbers, but JAX says: ": with_method(
        Wheeled, control=lambda self, action: action * jnp.ones(3)
    ),
    "control_period` must be `frame_skip` times the time step of the model, 1 * 0.01 s = 0.01 s, "
    "got 0.02 s: ": with_method(Wheeled, control_period=0.02),
    "control_period` must be `frame_skip` times the time step of the model, 5 * 0.01 s = 0.05 s, "
    "got 0.01 s: ": with_method(Wheeled, frame_skip=5),
    "instruction` must return the shape (1,), got ().": with_method(
        Point, instruction=lambda self, task: jnp.zeros(())
    ),
    "observe` must return the shape (2,), got (1,).": with_method(
        Point, observe=lambda self, readings: readings["qpos"][:1]
    ),
    "reward` must return the shape [(), ()], got [(1,), ()].": with_method(
        Point, reward=lambda self, *_: Reward(jnp.zeros(1), jnp.zeros(()))
    ),
    "terminated` must return the shape (), got (2,).": with_method(
        Point, terminated=lambda self, readings: readings["qpos"] > 0
    ),
    "truncated` must return the shape (), got (2,).": with_method(
        Point, truncated=lambda self, readings: readings["qpos"] > 0
    ),
    "solved` must return the shape (), got (2,).": with_method(
        Point, solved=lambda self, readings, task: readings["qpos"] > 0
    ),
    "position` must return the shape (2,), got (1,).": with_method(
        Point,
        position=lambda self, observation: observation[:1],
        judged_position=lambda self, readings, task: readings["qpos"],
    ),
    "goal` must return the shape (2,), got (3,).": with_method(
        Point, goal=lambda self, task: jnp.zeros(3)
    ),
}


@pytest.mark.parametrize("said", CONTRADICTIONS)
def test_an_environment_that_contradicts_itself_is_refused(said: str, tmp_path: Path) -> None:
    family: TaskFamily = POINT._replace(name="odd", make_env=CONTRADICTIONS[said])
    name = CONTRADICTIONS[said]().name
    with pytest.raises(RunError, match=re.escape(f"`{name}`: `{said}")):
        Run.create(tmp_path / "run", tiny_maesn(), tiny_settings(), family)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("xml", "said"),
    [
        (
            "<mujoco><worldbody><geom typ='box'/></worldbody></mujoco>",
            "unrecognized attribute: 'typ'",
        ),
        ("<mujoco><worldbody>", "XML parse error"),
        (
            "<mujoco><worldbody><body><joint/></body></worldbody></mujoco>",
            "mass and inertia of mov",
        ),
    ],
)
def test_a_model_with_an_error_is_refused_in_one_sentence(
    tmp_path: Path, xml: str, said: str
) -> None:
    path = tmp_path / "own.xml"
    path.write_text(xml)
    odd = POINT._replace(name="odd", make_env=with_method(Wheeled, model=str(path)))
    with pytest.raises(RunError, match=f"`model` '{path}' cannot be compiled.*{said}") as refused:
        Run.create(tmp_path / "run", tiny_maesn(), tiny_settings(), odd)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES)
@pytest.mark.parametrize("variant", ["reference", "paper"])
def test_the_librarys_own_environments_keep_their_word(family: TaskFamily, variant: str) -> None:
    check_env_contract(family.make_env(variant=variant), family.task_set("test")[0])


def test_what_a_function_raises_is_not_hidden(tmp_path: Path) -> None:
    broken = with_method(Point, observe=lambda self, readings: jnp.ones(2) @ jnp.ones(3))
    with pytest.raises(TypeError, match="contracting"):
        Run.create(tmp_path / "run", tiny_maesn(), tiny_settings(), POINT._replace(make_env=broken))


ATTACKS: list[dict[str, Any]] = [
    {"settings": {"seed": 1}},
    {"settings": {"reward": "sparse"}},
    {"settings": {"episodes_per_task": 4}},
    {"settings": {"engine": "mjx"}},
    {"versions": {}},
    {"provenance": {"commit": "0" * 40}},
    {"changes": [{"iteration": 0, "changed": {}, "digest": "0" * 16}]},
    {"more": 1},
]


@pytest.mark.parametrize("attack", ATTACKS, ids=str)
def test_whatever_is_changed_by_hand_is_noticed(directory: Path, attack: dict[str, Any]) -> None:
    path = directory / "config.json"
    document = json.loads(path.read_text())
    for name, value in attack.items():
        held = document.get(name)
        merged = isinstance(held, dict) and value
        document[name] = held | value if merged else value
    assert document != json.loads(path.read_text())
    path.write_text(json.dumps(document))
    with pytest.raises(RunError, match=r"was changed since maesn wrote it.*--change NAME=VALUE"):
        Run.open(directory)
    # With a digest that fits, it is not the file that the checkpoints were written with.
    edit(directory, **document)
    with pytest.raises(RunError, match=r"with another `config.json`|cannot be understood"):
        Run.open(directory).latest()


@pytest.mark.parametrize("digest", ["", None, 0, [], "drop"])
def test_a_digest_that_is_none_is_refused(directory: Path, digest: Any) -> None:
    path = directory / "config.json"
    document = json.loads(path.read_text()) | {"digest": digest}
    path.write_text(json.dumps({name: x for name, x in document.items() if x != "drop"}))
    with pytest.raises(RunError, match="was changed since maesn wrote it"):
        Run.open(directory)


def test_a_name_that_stands_twice_changes_nothing(directory: Path) -> None:
    """JSON readers differ in which one counts; here it is the one that the digest is of."""
    path, before = directory / "config.json", Run.open(directory).config
    text = path.read_text()
    path.write_text(text.replace('"seed": 0', '"seed": 5, "seed": 0'))
    assert Run.open(directory).config == before
    path.write_text(text.replace('"seed": 0', '"seed": 0, "seed": 5'))
    with pytest.raises(RunError, match="was changed since maesn wrote it"):
        Run.open(directory)
