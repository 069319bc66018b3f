"""What the report page shows of the latents: the path of each, and searches in a few new tasks."""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from maesn.reporting.reading import read_record

# Where a run directory has them.
LATENT_PATHS = Path("figures") / "latent-paths.npz"
SEARCHES = Path("figures") / "searches.npz"

_REMEDY = "delete it, and `maesn report DIR` records it again"

Record = TypeVar("Record")


@dataclass(frozen=True)
class LatentPaths:
    """An episode of each of many latents, in one task."""

    latents: Float[np.ndarray, "latent z"]
    paths: Float[np.ndarray, "latent point 2"]
    """Planar positions in metres, thinned out."""


@dataclass(frozen=True)
class RecordedSearches:
    """Latent search in some new tasks, one episode after the other.

    Beliefs are of the part of the return that depends on the latent, over a square of the first two
    components; the others are those of the deployed latent.
    """

    task: Float[np.ndarray, " task"]
    """Indices of the tasks."""
    edge: float
    """The square goes from -edge to edge."""
    played: Float[np.ndarray, "task episode z"]
    returns: Float[np.ndarray, "task episode"]
    reached: Float[np.ndarray, "task episode"]
    """1 where an episode reached the goal."""
    paths: Float[np.ndarray, "task episode point 2"]
    """Planar positions in metres, thinned out."""
    deployed: Float[np.ndarray, "task episode_plus_1 z"]
    """The latent of the highest posterior mean, before each episode and after the last."""
    mean: Float[np.ndarray, "task episode_plus_1 row column"]
    """Posterior mean; rows are the second component."""
    std: Float[np.ndarray, "task episode_plus_1 row column"]
    """Posterior standard deviation."""


def read_latent_paths(run: Path) -> LatentPaths | None:
    """Read a run's recorded paths of latents; None if there are none."""
    return _read(LatentPaths, run / LATENT_PATHS)


def read_searches(run: Path) -> RecordedSearches | None:
    """Read a run's recorded searches; None if there are none."""
    return _read(RecordedSearches, run / SEARCHES)


def _read(kind: type[Record], path: Path) -> Record | None:
    return read_record(kind, path, _REMEDY) if path.exists() else None
