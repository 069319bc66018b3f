"""The search of an exported policy, which files hold as arrays and numbers."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from maesn.runtime.archive import entry
from maesn.runtime.arrays import Arrays, named, take
from maesn.runtime.return_model import (
    NOMINAL,
    PRIOR_ARRAYS,
    PRIOR_NUMBERS,
    ReturnModel,
    ReturnPrior,
)
from maesn.runtime.search_settings import SearchSettings


@dataclass(frozen=True)
class ExportedSearch:
    """What a robot needs to search.

    Attributes:
        prior: what training tasks return for an archive of latents.
        settings: how the search chooses.
        horizon: steps of an episode of full length.
    """

    prior: ReturnPrior
    settings: SearchSettings
    horizon: int

    @cached_property
    def model(self) -> ReturnModel:
        """The model of returns."""
        return self.settings.model(self.prior)

    def arrays(self) -> Arrays:
        """Return the arrays to save in a file."""
        arrays = named("prior", self.prior, *PRIOR_ARRAYS)
        return {name: x.astype(np.float32) for name, x in arrays.items()}

    def metadata(self) -> dict[str, Any]:
        """Return the other values to save in a file."""
        found = ((name, getattr(self.prior, name)) for name in PRIOR_NUMBERS)
        numbers = {name: list(value) if np.ndim(value) else value for name, value in found}
        return numbers | {"horizon": self.horizon, "settings": asdict(self.settings)}

    @staticmethod
    def from_archive(
        arrays: Arrays, metadata: Mapping[str, Any], latent_size: int
    ) -> "ExportedSearch":
        """Rebuild a saved search; raises ValueError if a part is missing or does not fit."""
        latents = take(arrays, "prior.latents", -1, latent_size)
        prior = ReturnPrior(
            latents,
            take(arrays, "prior.excess", -1, len(latents)),
            take(arrays, "prior.noise", len(latents)),
            entry(metadata, "episodes", int),
            entry(metadata, "offset_mean", float),
            entry(metadata, "offset_std", float),
            *(_levels(metadata, name) for name in ("proposed_levels", "deployed_levels")),
        )
        try:
            settings = SearchSettings(**entry(metadata, "settings", dict))
        except TypeError as error:
            raise ValueError(f"entry `settings` of the search is damaged: {error}") from error
        return ExportedSearch(prior, settings, entry(metadata, "horizon", int))


def _levels(metadata: Mapping[str, Any], name: str) -> list[float]:
    """Return two levels; those of the model if the file has none."""
    levels = entry({name: list(NOMINAL), **metadata}, name, list)
    if len(levels) != 2 or not all(isinstance(level, float) for level in levels):
        raise ValueError(f"entry `{name}` must be two numbers, got {levels!r}.")
    return levels
