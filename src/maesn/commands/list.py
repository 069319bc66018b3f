"""`maesn list`: the methods and the families of tasks."""

import dataclasses
import sys

from maesn.commands.options import parse
from maesn.envs import FAMILIES, PROBES, TaskFamily
from maesn.learners import PRESETS


@dataclasses.dataclass(frozen=True)
class Options:
    """List the methods and the families of tasks."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    parse(Options, "list", arguments)
    print("methods:")
    for name, preset in PRESETS.items():
        print(f"  {name:16s}{_first_line(preset.__doc__)}")
    print("families:")
    for name, family in FAMILIES.items():
        print(f"  {name:16s}{_describe(family)}")
    print("probes, with known optimum:")
    for name, family in PROBES.items():
        print(f"  {name:16s}{_describe(family)}")


def _describe(family: TaskFamily) -> str:
    """Return the first line of the module that the family's environment is written in."""
    return _first_line(sys.modules[family.make_env.__module__].__doc__)


def _first_line(text: str | None) -> str:
    return (text or "").strip().splitlines()[0]
