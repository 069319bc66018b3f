"""The published curves, digitised from the paper's figures, and what they can stand beside."""

import csv
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maesn.reporting.reading import AdaptationTable

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
    """Return what the paper shows for a preset; None if nothing, or if its table means another."""
    radius, episodes = _PROTOCOLS.get(family, (None, None))
    name, is_ours = _PUBLISHED_NAME.get(method), (variant, table.reward) == ("reference", "sparse")
    if not (name and is_ours and sparse_radius in (None, radius)):
        return None
    if table.episodes_per_update != episodes:
        return None
    text = files("maesn.reporting").joinpath("published_curves.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    found = [(row["update"], row[name]) for row in rows if row["family"] == family and row[name]]
    return PublishedCurve(name, *np.array(found, float).T) if found else None
