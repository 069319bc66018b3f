"""Studies as TOML files: each wrong key or value is one sentence that names its place."""

import dataclasses
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from maesn import learners
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.protocols import settings_by
from maesn.rules import KNOWN, from_text
from maesn.serialization import decode
from maesn.settings import suggestion
from maesn.storage import RunError, explained
from maesn.studies.spec import EvaluationSpec, Place, RunSpec, StudySpec, is_for


def shipped_studies() -> dict[str, Path]:
    """Return the studies that come with the library, by name."""
    folder = Path(str(files("maesn.studies")))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def read_study(source: str | Path) -> StudySpec:
    """Read a study: a path, else the name of one that comes with the library.

    A `RunError` says that there is none, or which key is wrong.
    """
    path = Path(source)
    path = path if path.is_file() else shipped_studies().get(str(source), path)
    if not path.is_file():
        known = shipped_studies()
        raise RunError(
            f"there is no study `{source}`: give a .toml file, or one of {', '.join(known)}."
            + suggestion(str(source), known)
        )
    with explained("read", path):
        content = path.read_bytes()
    try:
        table = tomllib.loads(content.decode())
    except (ValueError, RecursionError) as error:
        raise RunError(f"`{path}` is not TOML: {error}.") from error
    if "families" not in table:
        table["families"] = table.pop("family", [])
    place = Place(str(source))
    study: StudySpec = _object(StudySpec, table, place, name=path.stem, file=place.file)
    return study


def _read(hint: Any, value: Any, place: Place) -> Any:
    kind, arguments = get_origin(hint), get_args(hint)
    if kind is tuple and not isinstance(value, list):
        value = [value]  # one for a list of one
    if kind is tuple and dataclasses.is_dataclass(arguments[0]):
        numbered = enumerate(value, start=1)
        return tuple(_read(arguments[0], one, place / number) for number, one in numbered)
    if not (kind is Mapping or dataclasses.is_dataclass(hint)):
        with place.refusing():
            return decode(value, hint, place.key.rpartition(".")[2])
    with place.refusing():
        if not isinstance(value, dict):
            raise ValueError(f"expected a table, got {value!r}.")
    if kind is Mapping:
        return {name: _read(arguments[1], one, place / name) for name, one in value.items()}
    own = {RunSpec: _run, EvaluationSpec: _evaluations, Evaluation: _evaluation}
    return own[hint](value, place) if hint in own else _object(hint, value, place)


def _object(kind: Any, table: Mapping[str, Any], place: Place, **given: Any) -> Any:
    """Build a dataclass from a table; the fields in `given` are no keys of the table."""
    hints = get_type_hints(kind)
    place.check(table, [name for name in hints if name not in given], "key")
    values = {name: _read(hints[name], value, place / name) for name, value in table.items()}
    with place.refusing():
        return kind(**given, **values)


def _run(table: Mapping[str, Any], place: Place) -> Any:
    """Read a run; keys that are not its own are settings of the learner or the run."""
    own = get_type_hints(RunSpec).keys() - {"changes"}
    plain = {name: value for name, value in table.items() if name in own}
    changes = {name: value for name, value in table.items() if name not in own}
    return _object(RunSpec, plain, place, changes=changes)


def _evaluations(table: Mapping[str, Any], place: Place) -> EvaluationSpec:
    """Read an evaluation, and the changes to it on single families."""
    usual = {name: value for name, value in table.items() if name != "on"}
    own = _read(Mapping[str, Mapping[str, Any]], table.get("on", {}), place / "on")
    on = {name: _evaluation(usual | own[name], place / "on" / name) for name in own}
    return EvaluationSpec(_evaluation(usual, place), on)


def _evaluation(table: Mapping[str, Any], place: Place) -> Any:
    """Read an evaluation: rule and wrappers are texts; the study gives seed and threads."""
    chosen = {}
    for option in (one for one in KNOWN if one in table):
        with (place / option).refusing():
            chosen[option] = from_text(option, decode(table[option], str, option))
    with (place / "protocol").refusing():
        by = settings_by(table.get("protocol")).items()
    usual = {name: [*value] if isinstance(value, tuple) else value for name, value in by}
    plain = usual | {name: value for name, value in table.items() if name not in KNOWN}
    given = {"rule": chosen.pop("rule", None), "wrappers": tuple(chosen.values())}
    return _object(Evaluation, plain, place, **given, num_threads=None, seed=0)


def check_names(study: StudySpec) -> None:
    """Refuse names of families, runs, evaluations and lines that do not exist."""
    place = Place(study.file)
    with (place / "families").refusing():
        for family in study.families:
            study.world(family), study.family(family)
    (place / "oracle").check(study.oracle, study.runs)
    for name, run in study.runs.items():
        if not run.directories and ":" not in run.preset:
            (place / "runs" / name / "preset").check(run.preset or name, learners.PRESETS, "method")
    for name, scratch in study.scratch.items():
        here = place / "scratch" / name / "method"
        here.check(scratch.method or name, learners.SCRATCH, "method from scratch")
    names = [name for line in study.all_lines for name in study.names_of(line).values()]
    known: dict[str, Iterable[str]] = {
        "families": study.families,
        "on": study.families,
        "run": study.runs,
        "scratch": study.scratch,
        "evaluation": study.evaluations,
        "lines": [*study.runs, *study.scratch, *names],
    }
    for key in ("runs", "evaluations", "lines", "figures"):
        specs = getattr(study, key)
        named = specs.items() if isinstance(specs, Mapping) else enumerate(specs, start=1)
        for which, spec in named:
            for field in known.keys() & vars(spec):
                (place / key / which / field).check(getattr(spec, field), known[field])
    for family in study.families:
        lines = [line for line in study.all_lines if is_for(family, line)]
        count = Counter(name for line in lines for name in study.names_of(line).values())
        with (place / "lines").refusing():
            if twice := [name for name in count if count[name] > 1]:
                raise ValueError(f"two lines have the name `{twice[0]}`: rename a run.")
