"""`maesn train METHOD --run DIR`: meta-train in a new run directory."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from maesn import api, learners
from maesn.commands.options import parse, read_first
from maesn.commands.runs import say_what_is_next
from maesn.envs import is_own
from maesn.envs.sources import resolve_family
from maesn.learners import AbstractMetaLearner
from maesn.runs.config import RunSettings, make_env
from maesn.runs.process import enable_compilation_cache
from maesn.runs.sources import own_method
from maesn.runs.training import KEEP
from maesn.settings import in_files, suggestion
from maesn.storage import RunError


@dataclasses.dataclass(frozen=True)
class Options:
    """Meta-train a method on a family of tasks."""

    run_settings: Annotated[RunSettings, tyro.conf.arg(name="")]
    learner: Annotated[AbstractMetaLearner[Any, Any], tyro.conf.arg(name="")]
    settings: Literal["recommended", "reference"] = "recommended"
    """Which settings are the defaults. recommended: those that were found to work on the family,
    where they are known. reference: the published ones. A method of your own has its own."""
    run: Path | None = None
    """Directory of the new run; it must not hold a run yet. None: runs/METHOD-FAMILY-SEED."""
    init_from: Path | None = None
    """Run whose weights training starts from: its directory, or the name of a policy that comes
    with the library. What belongs to single tasks, such as latents, begins afresh."""
    devices: int | None = None
    """Number of devices that share the tasks of a meta-batch. On a CPU, devices are threads. None:
    one; but for a method whose inner update moves the policy's weights, the largest number up to
    that of the cores which divides the tasks."""
    keep: int = KEEP
    """Number of latest checkpoints to keep, beside the first. 0: keep all."""


_HELP = f"""usage: maesn train METHOD --run DIR [OPTIONS]

METHOD is one of: {", ".join(learners.PRESETS)};
or `module:name` of your own, such as a class `name` in the file `module.py`.
`maesn train METHOD --family FAMILY --help` lists all settings, with the defaults of the method on
that family. Those of `maesn`:
"""


def train(arguments: list[str]) -> None:
    """Run `maesn train`, whose options depend on the method and the family."""
    method, *rest = arguments or ["--help"]
    if method in ("-h", "--help"):
        print(_HELP)
        read_options("maesn", ["--help"])
    if ":" not in method and method not in learners.PRESETS:
        hint, known = suggestion(method, learners.PRESETS), ", ".join(learners.PRESETS)
        raise RunError(
            f"there is no method `{method}`.{hint} Known are: {known}; give your own as "
            "`module:name`."
        )
    options = read_options(method, rest)
    enable_compilation_cache()
    settings = options.run_settings
    names = (
        name.rpartition(":")[2] if is_own(name) else in_files(name)
        for name in (method, settings.family)
    )
    directory = options.run or Path("runs") / "-".join([*names, str(settings.seed)])
    env = make_env(resolve_family(settings.family), settings)
    # Actions are choices in some families: nobody should have to say so.
    learner = options.learner.for_actions(env.action_kind)
    if ":" in method:
        settings = dataclasses.replace(settings, method=method)
    given = {name: getattr(options, name) for name in ("init_from", "keep", "devices")}
    say_what_is_next(api.train(learner, settings, directory, **given))


def read_options(method: str, arguments: list[str]) -> Options:
    """Return the options behind a method, whose defaults depend on `--family` and `--settings`."""
    found, _ = read_first(arguments, "family", "settings")
    family = found.family or RunSettings().family
    if ":" in method:
        default = Options(RunSettings(family=family), own_method(method))
    elif found.settings == "reference":
        default = Options(RunSettings(family=family), learners.PRESETS[method](), "reference")
    else:
        settings = RunSettings(family=family, **learners.recommended_run(method, family))
        default = Options(settings, learners.recommended(method, family))
    options: Options = parse(Options, f"train {method}", arguments, default)
    return options
