"""`maesn train METHOD --run DIR`: meta-train in a new run directory."""

import argparse
import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import tyro

from maesn import api, learners
from maesn.commands.options import parse
from maesn.commands.runs import say_what_is_next
from maesn.envs.sources import resolve_family
from maesn.learners import AbstractMetaLearner
from maesn.numerics.processes import ALONE, Sharing
from maesn.runs.config import RunSettings, make_env
from maesn.runs.process import enable_compilation_cache
from maesn.runs.serialization import differing
from maesn.runs.training import KEEP
from maesn.settings import suggestion
from maesn.storage import RunError

Source: TypeAlias = Literal["recommended", "reference"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Meta-train a method on a family of tasks."""

    run_settings: Annotated[RunSettings, tyro.conf.arg(name="")]
    learner: Annotated[AbstractMetaLearner[Any, Any], tyro.conf.arg(name="")]
    settings: Source = "recommended"
    """recommended: the defaults are what was found to work on the family, where that is known;
    reference: they are the published ones."""
    run: Path | None = None
    """Directory of the new run; must be empty or not exist. None: runs/METHOD-FAMILY-SEED."""
    init_from: Path | None = None
    """Directory of a run, or name of a policy that comes with the library, whose policy and step
    sizes to start from."""
    sharing: Annotated[Sharing, tyro.conf.arg(name="")] = ALONE
    keep: int = KEEP
    """Latest checkpoints that stay, beside the first; 0: all of them."""


def train(arguments: list[str]) -> None:
    """Run `maesn train`, whose options depend on the method and the family."""
    known = ", ".join(learners.PRESETS)
    if not arguments:
        raise RunError(f"name a method: maesn train METHOD --run DIR. Known are: {known}.")
    if arguments[0] in ("-h", "--help"):
        print(
            "usage: maesn train METHOD --run DIR [OPTIONS]\n\n"
            f"METHOD is one of: {known}.\n"
            f"METHOD{learners.BONUS_SUFFIX} gets a bonus for what it finds out as well.\n"
            "`maesn train METHOD --family FAMILY --help` lists all settings, with the defaults of\n"
            "the method on that family. Those of `maesn`:\n"
        )
        read_options("maesn", arguments)
    method, *rest = arguments
    if method in learners.SCRATCH:
        raise RunError(
            f"`{method}` is not meta-trained: it learns each task from scratch, as in "
            f"`maesn compare --scratch {method} --family FAMILY --out DIR`."
        )
    if method not in learners.METHODS:
        hint = suggestion(method, learners.METHODS)
        raise RunError(f"there is no method `{method}`.{hint} Known are: {known}.")
    _train(method, read_options(method, rest))


def _train(method: str, options: Options) -> None:
    enable_compilation_cache()
    settings = options.run_settings
    directory = options.run or Path("runs") / f"{method}-{settings.family}-{settings.seed}"
    env = make_env(resolve_family(settings.family), settings)
    # Actions are choices in some families: nobody should have to say so.
    learner = options.learner.for_actions(env.action_kind)
    _say_what_suits(method, options)
    given = {name: getattr(options, name) for name in ("init_from", "keep", "sharing")}
    say_what_is_next(api.train(learner, settings, directory, **given))


def read_options(method: str, arguments: list[str]) -> Options:
    """Return the options behind a method, whose defaults depend on `--family` and `--settings`."""
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument("--family", nargs="?")
    first.add_argument("--settings", nargs="?")
    found, _ = first.parse_known_args(arguments)
    source: Source = "reference" if found.settings == "reference" else "recommended"
    default = _defaults(method, found.family or RunSettings().family, source)
    options: Options = parse(Options, f"train {method}", arguments, default)
    return options


def _defaults(method: str, family: str, source: Source) -> Options:
    if source == "reference":
        return Options(RunSettings(family=family), learners.METHODS[method](), source)
    settings = RunSettings(family=family, **learners.recommended_run(method, family))
    return Options(settings, learners.recommended(method, family), source)


def _say_what_suits(method: str, options: Options) -> None:
    """Print the defaults that are the family's own and were not overridden."""
    family = options.run_settings.family
    suited, usual = (_defaults(method, family, s) for s in ("recommended", "reference"))
    own, chosen = (
        differing(one.run_settings, usual.run_settings) | differing(one.learner, usual.learner)
        for one in (suited, options)
    )
    kept = [f"{name} {value}" for name, value in own.items() if chosen.get(name) == value]
    if kept:
        print(
            f"settings that suit `{family}`: {', '.join(kept)} (--settings reference for the "
            "published ones)"
        )
