"""Settings that were found to work on a family, each with where that is shown.

A method's preset has the published settings, or its reference's. On some families others do better;
they are listed here and nowhere else. `results/settings.md` says how they were found.
"""

import dataclasses
from typing import Any, NamedTuple, TypeVar

from maesn.learners.base import AbstractMetaLearner
from maesn.learners.presets import PRESETS
from maesn.policies import AnnealedGaussianMLP

Settings = TypeVar("Settings")


class Recommendation(NamedTuple):
    """A setting that differs from the preset's."""

    value: Any
    source: str
    """File with the evidence, and what it shows."""


# Latents that begin at 0, the mean of the prior, instead of at draws from it.
_SPREAD_ON_WHEELED = Recommendation(
    0.0,
    "results/settings.md: -332.6 and -334.9 after ten updates where three seeds that begin at "
    "draws are at -343.6 in the mean",
)
_SPREAD_ON_BLOCKPUSH = Recommendation(
    0.0, "results/settings.md: -236.4 after ten updates where draws lead to -244.8"
)
_DAMPING_ON_BLOCKPUSH = Recommendation(
    1e-2,
    "results/settings.md: with 1e-5 the actions' standard deviation stays near 1. Chosen on the "
    "returns of training, of 3e-3 to 3e-2",
)

_SPREAD_ON_ANT = Recommendation(
    0.0,
    "results/settings.md: a dense return after the update of 421 where draws lead to 391, in "
    "iterations 71 to 75 of 20 x 20",
)
_FALLING_NOISE_ON_ANT = Recommendation(
    AnnealedGaussianMLP(),
    "results/settings.md: a third of the noise, and nothing else, is worth 22 in validation tasks",
)

RECOMMENDED: dict[str, dict[str, dict[str, Recommendation]]] = {
    "wheeled": {"maesn": {"context.initial_spread": _SPREAD_ON_WHEELED}},
    "blockpush": {
        "maesn": {
            "context.kl_weight": Recommendation(
                0.5,
                "results/settings.md: a dense return after the update of -122 where weight 0.1 "
                "gives -129; chosen on the returns of training",
            ),
            "context.initial_spread": _SPREAD_ON_BLOCKPUSH,
            "outer.trust_region.damping": _DAMPING_ON_BLOCKPUSH,
        },
        **{
            method: {"outer.trust_region.damping": _DAMPING_ON_BLOCKPUSH}
            for method in ("latent_space", "maml", "maml_bias_only", "oracle")
        },
    },
    "ant": {
        "maesn": {"context.initial_spread": _SPREAD_ON_ANT, "policy": _FALLING_NOISE_ON_ANT},
    },
}
"""Family -> method -> path of a setting or a slot of the learner -> its value."""

RECOMMENDED_RUNS: dict[str, dict[str, dict[str, Recommendation]]] = {
    "blockpush": {
        "maesn": {
            "episodes_per_task": Recommendation(
                50, "results/settings.md: -244.8 after 300 iterations; 200 with 20 lead to -266.7"
            )
        }
    },
    "ant": {
        "maesn": {
            "episodes_per_task": Recommendation(50, "results/settings.md: 387.6 after ten updates")
        }
    },
}
"""Family -> method -> setting of the run -> its value."""


def recommended(method: str, family: str) -> AbstractMetaLearner[Any, Any]:
    """Return a method with the settings that suit a family; its preset where none are known.

    Args:
        method: as in `maesn.PRESETS`.
        family: name of a family.

    Raises:
        ValueError: there is no such method.
    """
    if method not in PRESETS:
        raise ValueError(f"`method` must be one of {', '.join(PRESETS)}, got {method!r}.")
    learner = PRESETS[method]()
    for path, value in recommended_settings(method, family).items():
        learner = with_setting(learner, path, value)
    return learner


def recommended_settings(method: str, family: str) -> dict[str, Any]:
    """Return the settings of the learner that suit a family, by path; none where none are known."""
    found = RECOMMENDED.get(family, {}).get(method, {})
    return {path: recommendation.value for path, recommendation in found.items()}


def recommended_run(method: str, family: str) -> dict[str, Any]:
    """Return the settings of a run that suit a method on a family, by name."""
    found = RECOMMENDED_RUNS.get(family, {}).get(method, {})
    return {name: recommendation.value for name, recommendation in found.items()}


def with_setting(settings: Settings, path: str, value: Any) -> Settings:
    """Return settings with another value at a path such as `outer.trust_region.damping`."""
    name, _, rest = path.partition(".")
    if rest:
        value = with_setting(getattr(settings, name), rest, value)
    return dataclasses.replace(settings, **{name: value})  # type: ignore[type-var]
