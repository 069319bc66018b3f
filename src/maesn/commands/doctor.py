"""`maesn doctor`: what is installed and found, and whether a robot moves."""

import os
from collections.abc import Sequence
from importlib.metadata import distributions
from tempfile import TemporaryFile

import jax
import numpy as np

from maesn._version import __version__
from maesn.commands.options import command
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import evaluate
from maesn.runs.config import installed_versions
from maesn.runs.process import CACHE_VARIABLE, cache_directory
from maesn.runs.run import Run
from maesn.runs.sources import policy_names
from maesn.storage import RunError

_EXTRAS = {
    "gym": "gymnasium",
    "gpu": "mujoco-mjx",
    "ray": "ray",
    "cmaes": "cmaes",
    "page": "plotly",
}


@command
def doctor() -> None:
    """Show versions, engine, cores, graphics card, cache and policies; let a robot drive."""
    packages = {"maesn": __version__} | installed_versions("mujoco.batch")
    facts: dict[str, Sequence[object]] = {
        "versions": [f"{name} {number}" for name, number in packages.items()],
        "extras": [extra for extra, name in _EXTRAS.items() if any(distributions(name=name))],
        "cores": [len(os.sched_getaffinity(0))],
        "JAX runs on": jax.devices(),
        "cache": [_cache()],
        "policies": policy_names(),
    }
    for name, found in facts.items():
        print(f"{name:12s} {', '.join(map(str, found)) or 'none'}")
    print(f"{'self test':12s} {_drive()}")


def _cache() -> str:
    if (directory := cache_directory()) is None:
        return "off"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=directory):
            return str(directory)
    except OSError as error:
        raise RunError(
            f"the cache `{directory}` cannot be written ({error.strerror}): name another one by "
            f"the variable {CACHE_VARIABLE}, or say {CACHE_VARIABLE}=off."
        ) from error


def _drive() -> str:
    few = Evaluation(num_tasks=2, episodes=20, episodes_per_update=10)
    returns = evaluate(Run.open("wheeled"), few)[0].explored.mean_return
    if not np.isfinite(returns).all():
        raise RunError(f"`wheeled` returned {returns}, which is not finite.")
    return "`wheeled` drove in two tasks; all is well"
