"""What `outer_step_torch.py` and `outer_step_jax.py` share. Neither needs `maesn` itself."""

import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np

LAYERS = (100, 100)
INNER_STEP = 0.1
CG_STEPS = 10

Batch: TypeAlias = dict[str, np.ndarray]
"""Arrays `[task, episode, time, ...]` of a collection."""


def print_row(library: ModuleType, backend: str, step_of: Callable[[Batch, Batch], Any]) -> None:
    """Time `step_of(pre, post)` on the episodes that the command names, and print its row.

    Args:
        library: the package whose step it is, from a clone of its repository.
        backend: distribution that it computes with.
        step_of: takes the collections before and after the inner update; returns the step.
    """
    path, repetitions = sys.argv[1], int(sys.argv[2])
    with np.load(path) as arrays:
        batches = [
            {name[:-1]: arrays[name] for name in arrays if name.endswith(str(stage))}
            for stage in range(2)
        ]
    step, seconds = step_of(*batches), []
    for _ in range(1 + repetitions):
        begin = time.perf_counter()
        step()
        seconds.append(time.perf_counter() - begin)
    clone = Path(str(library.__file__)).parent.parent
    command = ["git", "-C", clone, "describe", "--always", "--dirty"]
    commit = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
    print(
        f"{np.median(seconds[1:]):8.2f} s  {library.__name__} {commit}, {backend} "
        f"{version(backend)}; first step {seconds[0]:.1f} s"
    )
