"""`maesn train METHOD --run DIR`: meta-train in a new run directory."""

import dataclasses
import difflib
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from maesn import api
from maesn.commands.options import parse
from maesn.learners import BONUS_SUFFIX, METHODS, PRESETS, SCRATCH, AbstractMetaLearner
from maesn.runs.compilation import enable_compilation_cache
from maesn.runs.config import RunSettings, make_env
from maesn.runs.task_sources import resolve_family
from maesn.storage import RunError


@dataclasses.dataclass(frozen=True)
class Options:
    """Meta-train a method on a family of tasks."""

    settings: Annotated[RunSettings, tyro.conf.arg(name="")]
    learner: Annotated[AbstractMetaLearner[Any, Any], tyro.conf.arg(name="")]
    run: Path | None = None
    """Directory of the new run; must be empty or not exist. None: runs/METHOD-FAMILY-SEED."""
    init_from: Path | None = None
    """Directory of a run, or name of a policy that comes with the library, whose policy and step
    sizes to start from."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    method, rest = _method(arguments)
    default = Options(RunSettings(), METHODS[method]())
    options = parse(Options, f"train {method}", rest, default)
    enable_compilation_cache()
    settings = options.settings
    directory = options.run or Path("runs") / f"{method}-{settings.family}-{settings.seed}"
    env = make_env(resolve_family(settings.family), settings)
    # Actions are choices in some families: nobody should have to say so.
    learner = options.learner.for_actions(env.action_kind)
    run = api.train(learner, settings, directory, init_from=options.init_from)
    next_command = f"maesn adapt {run.directory}{settings.family_option}"
    print(f"trained: {run.directory}\nnext:    {next_command}")


def _method(arguments: list[str]) -> tuple[str, list[str]]:
    """Return the method and the options behind it."""
    known = ", ".join(PRESETS)
    if not arguments:
        raise RunError(f"name a method: maesn train METHOD --run DIR. Known are: {known}.")
    if arguments[0] in ("-h", "--help"):
        print(
            "usage: maesn train METHOD --run DIR [OPTIONS]\n\n"
            f"METHOD is one of: {known}.\n"
            f"METHOD{BONUS_SUFFIX} is paid for what it finds out about the world as well.\n"
            "`maesn train METHOD --help` lists all settings with the method's defaults."
        )
        sys.exit(0)
    method = arguments[0]
    if method in SCRATCH:
        raise RunError(
            f"`{method}` is not meta-trained: it learns each task from scratch, as in "
            f"`maesn compare --scratch {method} --family FAMILY --out DIR`."
        )
    if method not in METHODS:
        near = difflib.get_close_matches(method, METHODS, n=1)
        hint = f" Did you mean `{near[0]}`?" if near else ""
        raise RunError(f"there is no method `{method}`.{hint} Known are: {known}.")
    return method, arguments[1:]
