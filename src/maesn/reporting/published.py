"""The published curves, digitised from the paper's figures, and what they can stand beside."""

import csv
import re
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maesn.reporting.reading import AdaptationTable

# The published returns depend on the rewards of the reference code, on tasks as in training, and on
# these: the sparse radius in metres, which is the family's own, and the episodes per update.
_PROTOCOLS = {"wheeled": (0.8, 50), "ant": (0.8, 50), "blockpush": (0.2, 20)}
_AS_IN_TRAINING = re.compile(r"(training|validation|test|final|final-2)(-first-\d+)?")


class PublishedCurve(NamedTuple):
    """One published curve; updates that could not be read are absent."""

    update: Float[np.ndarray, " point"]
    mean_return: Float[np.ndarray, " point"]


def comparable_curve(
    family: str, variant: str, sparse_radius: float | None, method: str, table: AdaptationTable
) -> PublishedCurve | None:
    """Return what the paper shows for a preset; None if nothing, or if its table means another."""
    if family not in _PROTOCOLS or not _AS_IN_TRAINING.fullmatch(table.tasks):
        return None
    radius, episodes = _PROTOCOLS[family]
    protocol = (variant, table.reward, table.episodes_per_update)
    if protocol != ("reference", "sparse", episodes) or sparse_radius not in (None, radius):
        return None
    text = files("maesn.reporting").joinpath("published_curves.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    of_family = (row for row in rows if row["family"] == family)
    found = [(row["update"], row[method]) for row in of_family if row.get(method)]
    return PublishedCurve(*np.array(found, float).T) if found else None
