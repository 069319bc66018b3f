"""Studies as TOML files: each wrong key or value is one sentence that names its place."""

import dataclasses
import difflib
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, get_args, get_origin, get_type_hints

from maesn import learners
from maesn.envs.sources import resolve_family
from maesn.evaluation.evaluation import Evaluation
from maesn.rules import KNOWN, from_text
from maesn.runs.serialization import decode
from maesn.storage import RunError, explained
from maesn.studies.spec import EvaluationSpec, RunSpec, StudySpec


class Place(NamedTuple):
    """A place in a study's file."""

    file: str
    keys: tuple[str, ...] = ()

    def __truediv__(self, key: str) -> "Place":
        return Place(self.file, (*self.keys, key))

    def refuse(self, text: object) -> NoReturn:
        """Raise a `RunError` that names the place."""
        at = f", `{'.'.join(self.keys)}`" if self.keys else ""
        raise RunError(f"`{self.file}`{at}: {text}")

    @contextmanager
    def refusing(self) -> Iterator[None]:
        """Name the place in what the block refuses."""
        try:
            yield
        except (RunError, ValueError) as error:
            self.refuse(error)

    def check(
        self, names: str | Iterable[str], known: Iterable[str], what: str = "such name"
    ) -> None:
        """Refuse names, or one, that are not known; an empty one stands for none."""
        for name in [names] if isinstance(names, str) else names:
            if name and name not in known:
                self.unknown(name, known, what)

    def unknown(self, name: str, known: Iterable[str], what: str) -> NoReturn:
        """Raise a `RunError` that says which known name is nearest."""
        near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.0)
        hint = f"The nearest one is `{near[0]}`." if near else "There are none."
        self.refuse(f"there is no {what} `{name}`. {hint}")


def shipped_studies() -> dict[str, Path]:
    """Return the studies that come with the library, by name."""
    folder = Path(str(files("maesn.studies")))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def read_study(source: str | Path) -> StudySpec:
    """Read a study: a path, else the name of one that comes with the library.

    Raises:
        RunError: there is none, or something in it cannot be; with its key.
    """
    path = Path(source)
    path = path if path.exists() else shipped_studies().get(str(source), path)
    if not path.is_file():
        raise RunError(
            f"there is no study `{source}`: give a .toml file, or one of "
            f"{', '.join(shipped_studies())}."
        )
    with explained("read", path):
        content = path.read_bytes()
    try:
        table = tomllib.loads(content.decode())
    except (ValueError, RecursionError) as error:
        raise RunError(f"`{path}` is not TOML: {error}.") from error
    return study_of_table(table, path.stem, Place(str(source)))


def study_of_table(table: Mapping[str, Any], name: str, place: Place) -> StudySpec:
    """Return the study that a table says; `RunError` with the key of what cannot be."""
    values = dict(table)
    family = values.pop("family", None)
    if isinstance(family, str):
        if "families" in values:
            place.refuse("give `family` or `families`, not both.")
        values["families"] = [family]
    if not values.get("families"):
        place.refuse('a study needs families, as in `family = "wheeled"`.')
    study: StudySpec = _object(StudySpec, values, place, name=name, file=place.file)
    _check_names(study, place)
    return study


def _read(hint: Any, value: Any, place: Place) -> Any:
    """Return what a value of a file is as a field of this type."""
    kind, arguments = get_origin(hint), get_args(hint)
    if dataclasses.is_dataclass(hint):
        own: dict[Any, Any] = {
            RunSpec: _run,
            EvaluationSpec: _evaluations,
            Evaluation: _evaluation,
        }
        read = own.get(hint, partial(_object, hint))
        return read(_table(value, place), place)
    if kind is Mapping and arguments[1] is Any:
        return _table(value, place)
    if kind is Mapping:
        for name in _table(value, place):
            if not name.replace("_", "").replace("-", "").isalnum():
                (place / name).refuse("a name has letters, digits, - and _ alone.")
        return {name: _read(arguments[1], one, place / name) for name, one in value.items()}
    if kind is tuple and dataclasses.is_dataclass(arguments[0]):
        if not isinstance(value, list):
            place.refuse(f"expected [[{place.keys[-1]}]], got {value!r}.")
        numbered = enumerate(value, start=1)
        return tuple(_read(arguments[0], one, place / str(number)) for number, one in numbered)
    # One name for a list of one.
    given = [value] if kind is tuple and not isinstance(value, list) else value
    with place.refusing():
        return decode(given, hint, place.keys[-1])


def _table(value: Any, place: Place) -> dict[str, Any]:
    if not isinstance(value, dict):
        place.refuse(f"expected a table, got {value!r}.")
    return value


def _object(
    kind: Any, table: Mapping[str, Any], place: Place, more: Iterable[str] = (), **given: Any
) -> Any:
    """Return a dataclass with what a table gives, and what is given here, which is no key there.

    `more` are keys that have been read, for the nearest one of what is none.
    """
    hints = get_type_hints(kind)
    place.check(table, [*(name for name in hints if name not in given), *more], "key")
    values = {name: _read(hints[name], value, place / name) for name, value in table.items()}
    with place.refusing():
        return kind(**given, **values)


def _run(table: Mapping[str, Any], place: Place) -> Any:
    """Read a run, of which all other keys are settings."""
    own = get_type_hints(RunSpec).keys() - {"changes"}
    plain = {name: value for name, value in table.items() if name in own}
    changes = {name: value for name, value in table.items() if name not in own}
    return _object(RunSpec, plain, place, changes=changes)


def _evaluations(table: Mapping[str, Any], place: Place) -> EvaluationSpec:
    """Read an evaluation, and those on single families, which have its settings as well."""
    usual = {name: value for name, value in table.items() if name != "on"}
    own = _read(Mapping[str, Mapping[str, Any]], table.get("on", {}), place / "on")
    on = {name: _evaluation(usual | own[name], place / "on" / name) for name in own}
    return EvaluationSpec(_evaluation(usual, place), on)


def _evaluation(table: Mapping[str, Any], place: Place) -> Any:
    """Read an evaluation, whose rule and wrappers are texts. Its seed and so on are the study's."""
    chosen = {option: table[option] for option in KNOWN if option in table}
    for option, text in chosen.items():
        here = place / option
        if not isinstance(text, str):
            here.refuse(
                f'expected words as on the command line, "NAME SETTING=VALUE", got {text!r}.'
            )
        with here.refusing():
            chosen[option] = from_text(option, text)
    plain = {name: value for name, value in table.items() if name not in KNOWN}
    rule = chosen.pop("rule", None)
    given = {"rule": rule, "wrappers": tuple(chosen.values())}
    of_study = {"engine": None, "num_threads": None, "seed": 0}
    return _object(Evaluation, plain, place, KNOWN, **given, **of_study)


def _check_names(study: StudySpec, place: Place) -> None:
    """Refuse names that nothing has, and a study that compares nothing."""
    for family in study.families:
        with (place / "families").refusing():
            resolve_family(family)
    (place / "oracle").check(study.oracle, study.runs)
    for name, run in study.runs.items():
        if not run.directories and ":" not in run.preset:
            (place / "runs" / name / "preset").check(run.preset or name, learners.METHODS, "method")
    for name, scratch in study.scratch.items():
        here = place / "scratch" / name / "method"
        here.check(scratch.method or name, learners.SCRATCH, "method from scratch")
    known: dict[str, Iterable[str]] = {
        "families": study.families,
        "on": study.families,
        "run": study.runs,
        "scratch": study.scratch,
        "evaluation": study.evaluations,
        "lines": [*study.runs, *study.scratch],
    }
    parts: dict[str, Mapping[Any, Any]] = {
        "runs": study.runs,
        "evaluations": study.evaluations,
        "lines": dict(enumerate(study.lines, start=1)),
        "figures": dict(enumerate(study.figures, start=1)),
    }
    for key, specs in parts.items():
        for name, spec in specs.items():
            for field, names in known.items():
                (place / key / str(name) / field).check(getattr(spec, field, ()), names)
    if not study.all_lines:
        place.refuse("nothing is compared: add `[runs.NAME]` or `[scratch.NAME]`.")
