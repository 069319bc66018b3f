"""The published curves, digitised from the paper's figures, and what they can stand beside."""

import csv
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maesn.reporting.adaptation_table import AdaptationTable

# Our presets -> the paper's names. All three MAML presets are compared with the one curve that was
# published; the table's header says what it is.
_PUBLISHED_NAME = {
    "maesn": "MAESN",
    "latent_space": "LatentSpace",
    "maml": "MAML",
    "maml_bias": "MAML",
    "maml_bias_only": "MAML",
    "rl2": "RL2",
    "vime": "VIME",
    "trpo": "TRPO",
    "reinforce": "VPG",
}

# What the published returns depend on, beside the rewards of the reference code: the sparse radius
# in metres (also the family's own, that of a run without one) and the episodes per update.
_PROTOCOLS = {"wheeled": (0.8, 50), "ant": (0.8, 50), "blockpush": (0.2, 20)}


class PublishedCurve(NamedTuple):
    """One published curve; updates that could not be read are absent."""

    name: str
    """The method's name in the paper."""
    update: Float[np.ndarray, " point"]
    mean_return: Float[np.ndarray, " point"]


def comparable_curve(
    family: str, variant: str, sparse_radius: float | None, method: str, table: AdaptationTable
) -> PublishedCurve | None:
    """Return the published curve of a method; None if its table means another thing."""
    radius, episodes = _PROTOCOLS.get(family, (None, None))
    is_comparable = (
        variant == "reference"
        and sparse_radius in (None, radius)
        and table.reward == "sparse"
        and table.episodes_per_update == episodes
    )
    return published_curve(family, method) if is_comparable else None


def published_curve(family: str, method: str) -> PublishedCurve | None:
    """Return what the paper shows for a preset; None if it shows nothing."""
    name = _PUBLISHED_NAME.get(method, "")
    text = files("maesn.reporting").joinpath("published_curves.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    found = [row for row in rows if row["family"] == family and row.get(name)]
    if not found:
        return None
    update, mean_return = np.array([(row["update"], row[name]) for row in found], float).T
    return PublishedCurve(name, update, mean_return)
