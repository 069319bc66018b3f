"""`maesn list`: the methods and the families of tasks."""

import dataclasses

from maesn.commands.options import parse
from maesn.envs import FAMILIES, PROBES
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
        print(f"  {name:16s}{_first_line(family.make_env.__doc__)}")
    print("probes, with known optimum:")
    for name, family in PROBES.items():
        print(f"  {name:16s}{_first_line(family.make_env.__doc__)}")


def _first_line(text: str | None) -> str:
    return (text or "").strip().splitlines()[0]
