"""`maesn train METHOD`: meta-train in a new run directory."""

import dataclasses
from typing import Any

from maesn import api, learners
from maesn.commands.options import command, read_first
from maesn.commands.runs import say_what_is_next
from maesn.learners import AbstractMetaLearner
from maesn.runs.config import RunSettings
from maesn.runs.sources import own_method
from maesn.settings import check_choice, suggestion
from maesn.storage import RunError, refusals

_HELP = f"""usage: maesn train METHOD [OPTIONS]

METHOD is one of: {", ".join(learners.PRESETS)};
or `module:name` of your own, such as a class `name` in the file `module.py`.
`maesn train METHOD --family FAMILY --help` lists all settings, with the defaults of the method on
that family: those that were found to work there, or with `--settings reference` the published ones.
Those of `maesn`:
"""


def train(arguments: list[str]) -> None:
    """Run `maesn train`, whose options depend on the method and the family."""
    method, *rest = arguments or ["--help"]
    if method in ("-h", "--help"):
        print(_HELP)
        method, rest = "maesn", ["--help"]
    if ":" not in method and method not in learners.PRESETS:
        hint, known = suggestion(method, learners.PRESETS), ", ".join(learners.PRESETS)
        raise RunError(
            f"there is no method `{method}`.{hint} Known are: {known}; give your own as "
            "`module:name`."
        )
    found, rest = read_first(rest, "settings")
    family = read_first(rest, "family")[0].family or RunSettings().family
    which = "recommended" if found.settings is None else found.settings
    learner, settings = usual(method, family, which)
    named = f"train {method}"
    command(api.train, say_what_is_next, named, settings=settings, learner=learner)(rest)


def usual(
    method: str, family: str, which: str
) -> tuple[AbstractMetaLearner[Any, Any], RunSettings]:
    """Return the defaults of the options: those that suit the family, or the published ones."""
    with refusals():
        check_choice("settings", which, ("recommended", "reference"))
    settings = RunSettings(method=method, family=family)
    if ":" in method:
        return own_method(method), settings
    if which == "reference":
        return learners.PRESETS[method](), settings
    suited = learners.recommended_run(method, family)
    return learners.recommended(method, family), dataclasses.replace(settings, **suited)
