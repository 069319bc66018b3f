"""`maesn list`: methods, families of tasks, and policies that come with the library."""

import dataclasses

from maesn.commands.options import parse
from maesn.envs import FAMILIES, PROBES
from maesn.learners import BONUS_SUFFIX, PRESETS, SCRATCH
from maesn.runs.config import read_config
from maesn.runs.shipped import TRAINED, policy_names


@dataclasses.dataclass(frozen=True)
class Options:
    """List methods, families of tasks, and policies that come with the library."""


def main(arguments: list[str]) -> None:
    """Run the command."""
    parse(Options, "list", arguments)
    print("methods:")
    for name, preset in PRESETS.items():
        print(f"  {name:16s}{_first_line(preset.__doc__)}")
    print(f"  {'NAME' + BONUS_SUFFIX:16s}Any of these, with a bonus for what it finds out in it.")
    print("from scratch, for `maesn compare --scratch`:")
    for name, make in SCRATCH.items():
        print(f"  {name:16s}{_first_line(make.__doc__)}")
    print("families:")
    for name, family in FAMILIES.items():
        print(f"  {name:16s}{_first_line(family.make_env.__doc__)}")
    print("trained policies, for `maesn adapt NAME`:")
    for name in policy_names():
        settings = read_config(TRAINED / name).settings
        print(f"  {name:16s}{settings.method}, {settings.iterations} meta-iterations")
    print("probes, with known optimum:")
    for name, family in PROBES.items():
        print(f"  {name:16s}{_first_line(family.make_env.__doc__)}")


def _first_line(text: str | None) -> str:
    return (text or "").strip().splitlines()[0]
