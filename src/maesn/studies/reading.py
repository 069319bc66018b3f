"""Studies as TOML files: each wrong key or value is one sentence that names its place."""

import dataclasses
import difflib
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeVar, get_type_hints

from maesn import learners
from maesn.envs.sources import resolve_family
from maesn.evaluation.evaluation import Evaluation
from maesn.rules import KNOWN, from_text
from maesn.runs.serialization import decode
from maesn.settings import leaves
from maesn.storage import RunError, explained
from maesn.studies.spec import (
    EvaluationSpec,
    FigureSpec,
    LineSpec,
    RunSpec,
    ScratchSpec,
    StudySpec,
)

Kind = TypeVar("Kind")

# What a study says once for all of its evaluations, or says in words.
_NOT_OF_AN_EVALUATION = ("rule", "wrappers", "engine", "num_threads", "seed")
_LISTS: dict[str, type] = {"lines": LineSpec, "figures": FigureSpec}


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

    def unknown(self, name: str, known: Iterable[str], what: str = "key") -> NoReturn:
        """Raise a `RunError` that says which known name is nearest."""
        listed = list(known)
        near = difflib.get_close_matches(name, listed, n=1, cutoff=0.0)
        hint = f" The nearest one is `{near[0]}`." if near else " There are none."
        self.refuse(f"there is no {what} `{name}`.{hint}")


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
    if isinstance(values.get("family"), str):
        if "families" in values:
            place.refuse("give `family` or `families`, not both.")
        values["families"] = [values.pop("family")]
    if not values.get("families"):
        place.refuse('a study needs families, as in `family = "wheeled"`.')
    given: dict[str, Any] = {"name": name, "file": place.file}
    for key, read in {"runs": _run, "evaluations": _evaluations, "scratch": _scratch}.items():
        if key in values:
            given[key] = _tables(values.pop(key), place / key, read)
    for key, kind in _LISTS.items():
        given[key] = _list(kind, values.pop(key, []), place / key)
    known = [one.name for one in dataclasses.fields(StudySpec) if one.name not in ("name", "file")]
    plain = _values(StudySpec, values, place, [*known, "family"])
    study = _made(StudySpec, given | plain, place)
    _check_names(study, place)
    return study


def _tables(table: Any, place: Place, read: Callable[[str, Any, Place], Kind]) -> dict[str, Kind]:
    for name, one in _table(table, place).items():
        if not name.replace("_", "").replace("-", "").isalnum():
            (place / name).refuse("a name has letters, digits, - and _ alone.")
        _table(one, place / name)
    return {name: read(name, one, place / name) for name, one in table.items()}


def _table(value: Any, place: Place) -> dict[str, Any]:
    if not isinstance(value, dict):
        place.refuse(f"expected a table, got {value!r}.")
    return value


def _list(kind: type[Kind], tables: Any, place: Place) -> tuple[Kind, ...]:
    if not isinstance(tables, list):
        place.refuse(f"expected [[{place.keys[-1]}]], got {tables!r}.")
    places = [place / str(number) for number in range(1, len(tables) + 1)]
    known = [one.name for one in dataclasses.fields(kind)]  # type: ignore[arg-type]
    return tuple(
        _made(kind, _values(kind, _table(table, here), here, known), here)
        for table, here in zip(tables, places, strict=True)
    )


def _values(
    kind: type, table: Mapping[str, Any], place: Place, known: Sequence[str]
) -> dict[str, Any]:
    """Return the fields of a dataclass that a table gives, of these names, in their types."""
    hints, values = get_type_hints(kind), {}
    for name, value in table.items():
        if name not in known:
            place.unknown(name, known)
        is_list = getattr(hints[name], "__origin__", None) is tuple
        # One name for a list of one.
        one = [value] if is_list and not isinstance(value, list) else value
        with (place / name).refusing():
            values[name] = decode(one, hints[name], name)
    return values


def _made(kind: Callable[..., Kind], values: Mapping[str, Any], place: Place) -> Kind:
    with place.refusing():
        return kind(**values)


def _scratch(name: str, table: Mapping[str, Any], place: Place) -> ScratchSpec:
    known = [one.name for one in dataclasses.fields(ScratchSpec)]
    spec = _made(ScratchSpec, {"method": name, **_values(ScratchSpec, table, place, known)}, place)
    if spec.method not in learners.SCRATCH:
        (place / "method").unknown(spec.method, learners.SCRATCH, "method from scratch")
    return spec


def _run(name: str, table: Mapping[str, Any], place: Place) -> RunSpec:
    own = [f.name for f in dataclasses.fields(RunSpec) if f.name not in ("on", "changes")]
    plain = {key: value for key, value in table.items() if key in own}
    changes = leaves({key: value for key, value in table.items() if key not in (*own, "on")})
    on = _tables(table.get("on", {}), place / "on", lambda _, more, __: leaves(more))
    values = {"preset": name, **_values(RunSpec, plain, place, own)}
    spec = RunSpec(**values, on=on, changes=changes)
    if not spec.directories and ":" not in spec.preset and spec.preset not in learners.METHODS:
        (place / "preset").unknown(spec.preset, learners.METHODS, "method")
    return spec


def _evaluations(_: str, table: Mapping[str, Any], place: Place) -> EvaluationSpec:
    usual = {key: value for key, value in table.items() if key != "on"}
    return EvaluationSpec(
        _evaluation(usual, place),
        _tables(
            table.get("on", {}), place / "on", lambda _, own, at: _evaluation({**usual, **own}, at)
        ),
    )


def _evaluation(table: Mapping[str, Any], place: Place) -> Evaluation:
    known = [f.name for f in dataclasses.fields(Evaluation) if f.name not in _NOT_OF_AN_EVALUATION]
    plain = {key: value for key, value in table.items() if key not in KNOWN}
    values = _values(Evaluation, plain, place, [*known, *KNOWN])
    added = {
        option: _named(option, table[option], place / option) for option in KNOWN if option in table
    }
    rule = added.pop("rule", None)
    return _made(Evaluation, values | {"rule": rule, "wrappers": tuple(added.values())}, place)


def _named(option: str, text: Any, place: Place) -> Any:
    if not isinstance(text, str):
        place.refuse(f'expected words as on the command line, "NAME SETTING=VALUE", got {text!r}.')
    with place.refusing():
        return from_text(option, text)


def _check_names(study: StudySpec, place: Place) -> None:
    """Refuse names that nothing has, and a study that compares nothing."""
    for family in study.families:
        with (place / "families").refusing():
            resolve_family(family)
    for key, known, named in _references(study):
        for name in named:
            if name not in known:
                Place(place.file, key).unknown(name, known, "such name")
    if not study.all_lines:
        place.refuse("nothing is compared: add `[runs.NAME]` or `[scratch.NAME]`.")
    for number, line in enumerate(study.lines, start=1):
        if bool(line.run) == bool(line.scratch):
            (place / "lines" / str(number)).refuse("a line needs `run` or `scratch`, one of both.")


def _references(
    study: StudySpec,
) -> Iterable[tuple[tuple[str, ...], Iterable[str], Iterable[str]]]:
    """Yield the keys at which a study refers to its parts: place, the parts' names, those named."""
    yield ("oracle",), study.runs, filter(None, [study.oracle])
    for name, run in study.runs.items():
        yield ("runs", name, "families"), study.families, run.families
        yield ("runs", name, "on"), study.families, run.on
    for name, evaluation in study.evaluations.items():
        yield ("evaluations", name, "on"), study.families, evaluation.on
    for number, line in enumerate(study.lines, start=1):
        key = ("lines", str(number))
        yield (*key, "run"), study.runs, filter(None, [line.run])
        yield (*key, "scratch"), study.scratch, filter(None, [line.scratch])
        yield (*key, "evaluation"), study.evaluations, line.evaluation
        yield (*key, "families"), study.families, line.families
    for number, figure in enumerate(study.figures, start=1):
        key = ("figures", str(number))
        yield (*key, "lines"), [*study.runs, *study.scratch], figure.lines
        yield (*key, "families"), study.families, figure.families
