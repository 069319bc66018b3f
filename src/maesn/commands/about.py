"""The commands `maesn list` and `maesn doctor`."""

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import jax
import numpy as np

from maesn._version import __version__
from maesn.commands.options import command
from maesn.envs import FAMILIES, HOSTED
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import evaluate
from maesn.learners import PRESETS, SCRATCH
from maesn.rules import KNOWN, paths_of
from maesn.runs.config import installed_versions, read_config
from maesn.runs.run import Run
from maesn.runs.sources import TRAINED, policy_names
from maesn.serialization import fields_to_json
from maesn.settings import leaves
from maesn.storage import RunError, check_writable
from maesn.worlds.budget import num_cpus

# Packages that extras of the installation bring.
_EXTRAS = ("gymnasium",)


@command
def doctor() -> None:
    """Show versions, cores, graphics card, cache and policies; let a robot drive."""
    set_in = jax.config.values
    cache = set_in["jax_enable_compilation_cache"] and set_in["jax_compilation_cache_dir"]
    packages = {"maesn": __version__} | installed_versions("mujoco.batch")
    facts: dict[str, Sequence[object]] = {
        "versions": [f"{name} {number}" for name, number in packages.items()],
        "extras": [name for name in _EXTRAS if any(distributions(name=name))],
        "cores": [num_cpus()],
        "JAX runs on": jax.devices(),
        "cache": [cache or "off"],
        "policies": policy_names(),
    }
    for name, found in facts.items():
        print(f"{name:12s} {', '.join(map(str, found)) or 'none'}")
    if cache:
        check_writable(Path(cache) / "probe")
    asked = Evaluation(num_tasks=2, episodes=20, episodes_per_update=10)
    outcome, _ = evaluate(Run.open(TRAINED / "wheeled"), asked)
    if not np.isfinite(outcome.curves.mean_return).all():
        raise RunError("the self test failed: returns of `wheeled` are not finite numbers.")
    print(f"{'self test':12s} `wheeled` drove in two tasks; all is well")


@command
def list() -> None:  # noqa: A001
    """List methods, rules, families of tasks, and policies that come with the library."""
    _show("methods", _first_lines(PRESETS))
    _show("from scratch, for `maesn compare --scratch`", _first_lines(SCRATCH))
    for option, rules in KNOWN.items():
        settings = {name: _settings(rule()) for name, rule in rules.items()}
        described = _first_lines(rules)
        _show(f"for `--{option}`", {name: described[name] + settings[name] for name in rules})
    families = FAMILIES | HOSTED
    _show("families", _first_lines({name: one.make_env for name, one in families.items()}))
    trained = {name: read_config(TRAINED / name).settings for name in policy_names()}
    _show(
        "trained policies, for `maesn adapt NAME`",
        {name: f"{one.method}, {one.iterations} meta-iterations" for name, one in trained.items()},
    )


def _show(title: str, texts: Mapping[str, str]) -> None:
    width = max([15, *map(len, texts)])
    print(f"{title}:", *(f"  {name:{width}s} {text}" for name, text in texts.items()), sep="\n")


def _settings(rule: Any) -> str:
    """Return the settings of a rule with their defaults, as they are written behind its name."""
    values = leaves(fields_to_json(rule))
    shown = {name: json.dumps(values[path]) for name, path in paths_of(rule).items()}
    return "".join(f"\n{'':18s}{name}={value}" for name, value in shown.items())


def _first_lines(described: Mapping[str, Any]) -> dict[str, str]:
    return {name: one.__doc__.strip().splitlines()[0] for name, one in described.items()}
