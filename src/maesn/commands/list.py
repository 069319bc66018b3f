"""`maesn list`: methods, rules, families of tasks, and policies that come with the library."""

import json
from typing import Any

from maesn.commands.options import command
from maesn.envs import FAMILIES, PROBES
from maesn.evaluation.naming import KNOWN
from maesn.learners import BONUS_SUFFIX, PRESETS, SCRATCH
from maesn.runs.config import read_config
from maesn.runs.serialization import TAG, fields_to_json, leaves
from maesn.runs.sources import TRAINED, policy_names


@command
def list() -> None:  # noqa: A001
    """List methods, rules, families of tasks, and policies that come with the library."""
    print("methods:")
    for name, preset in PRESETS.items():
        print(f"  {name:16s}{_first_line(preset.__doc__)}")
    print(f"  {'NAME' + BONUS_SUFFIX:16s}Any of these, with a bonus for what it finds out in it.")
    print("from scratch, for `maesn compare --scratch`:")
    for name, make in SCRATCH.items():
        print(f"  {name:16s}{_first_line(make.__doc__)}")
    for option, rules in KNOWN.items():
        print(f"for `--{option}`:")
        for name, rule in rules.items():
            print(f"  {name:16s}{_first_line(rule.__doc__)}{_settings(rule())}")
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


def _settings(rule: Any) -> str:
    """Return the settings of a rule with their defaults, as they are written behind its name."""
    shown = {n: v for n, v in leaves(fields_to_json(rule)).items() if n.split(".")[-1] != TAG}
    return "".join(f"\n{'':18s}{name}={json.dumps(value)}" for name, value in shown.items())


def _first_line(text: str | None) -> str:
    return (text or "").strip().splitlines()[0]
