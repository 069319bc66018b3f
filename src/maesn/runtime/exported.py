"""The result of meta-training that a robot loads. It does not change there."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from maesn.runtime.actuators import Actuators
from maesn.runtime.archive import entry
from maesn.runtime.arrays import Arrays, take
from maesn.runtime.episode import PURPOSES, Purpose
from maesn.runtime.exported_search import ExportedSearch
from maesn.runtime.latent import Latent, LearningRule
from maesn.runtime.policy import GaussianPolicy
from maesn.runtime.sensors import Sensors

_SEARCH = "search"


class ExportedLearner(NamedTuple):
    """What a learner brings to an `ExportedPolicy`; the rest comes from its environment."""

    policy: GaussianPolicy
    """Its weights do not change on the robot."""
    start: Latent
    """The latent that a new task starts from."""
    rule: LearningRule
    """The policy-gradient update of the latent."""


@dataclass(frozen=True)
class ExportedPolicy:
    """A meta-learned policy with all that is needed to explore and learn with it.

    Attributes:
        policy: the policy, whose weights do not change on the robot.
        actuators: the map from actions to controls.
        sensors: the components of an observation.
        start: the latent that a new task starts from: the prior N(0, I), or an adapted one.
        start_update: number of updates that led to `start`; 0 for the prior.
        rule: the policy-gradient update of the latent.
        description: family, horizon (steps), control period (seconds) and the like, for people.
            Nothing depends on it.
        search: the search that chooses latents instead of `rule`, if any.
        is_noisy: purpose of an episode -> whether its actions are drawn, as in the simulation.
    """

    policy: GaussianPolicy
    actuators: Actuators
    sensors: Sensors
    start: Latent
    rule: LearningRule
    description: Mapping[str, str | int | float]
    start_update: int = 0
    search: ExportedSearch | None = None
    is_noisy: Mapping[Purpose, bool] = field(default_factory=lambda: dict.fromkeys(PURPOSES, True))

    @property
    def latent_size(self) -> int:
        """Number of components of z."""
        return int(self.start.mean.shape[0])

    @property
    def observation_size(self) -> int:
        """Number of components of an observation."""
        return self.policy.input_size - self.latent_size

    @property
    def action_size(self) -> int:
        """Number of components of an action, and of a control."""
        return self.policy.action_size

    @property
    def search_horizon(self) -> int:
        """Steps of a full episode, which a search alone needs; 1 without one."""
        return 1 if self.search is None else self.search.horizon

    def arrays(self) -> Arrays:
        """Return the arrays to save in a file."""
        return {
            **self.policy.arrays(),
            "actuators.offset": self.actuators.offset,
            "actuators.scale": self.actuators.scale,
            "actuators.lower": self.actuators.lower,
            "actuators.upper": self.actuators.upper,
            "sensors.lower": self.sensors.lower,
            "sensors.upper": self.sensors.upper,
            "start.mean": self.start.mean,
            "start.log_std": self.start.log_std,
            "rule.mean_step": self.rule.mean_step,
            "rule.log_std_step": self.rule.log_std_step,
            **({} if self.search is None else self.search.arrays()),
        }

    def metadata(self) -> dict[str, Any]:
        """Return the other values to save in a file."""
        return {
            "description": dict(self.description),
            "num_layers": len(self.policy.weights),
            "observation_size": self.observation_size,
            "sensors": list(self.sensors.names),
            "actuators": list(self.actuators.names),
            "is_noisy": dict(self.is_noisy),
            "start_update": self.start_update,
            "rule": {
                "full_steps": self.rule.full_steps,
                "factor": self.rule.factor,
                "discount": self.rule.discount,
                "ridge": self.rule.ridge,
            },
            **({} if self.search is None else {_SEARCH: self.search.metadata()}),
        }

    @staticmethod
    def from_archive(
        arrays: Mapping[str, NDArray[np.generic]], metadata: Mapping[str, Any]
    ) -> "ExportedPolicy":
        """Rebuild a saved policy; raises ValueError if a part is missing or does not fit."""
        start_mean = take(arrays, "start.mean", -1)
        size = start_mean.shape[0]
        sizes = {name: entry(metadata, name, int) for name in ("observation_size", "num_layers")}
        for name, number in sizes.items():
            if number < 1:
                raise ValueError(f"entry `{name}` must be at least 1, got {number}.")
        policy = GaussianPolicy.from_arrays(
            arrays, sizes["observation_size"] + size, sizes["num_layers"]
        )
        rule = entry(metadata, "rule", dict)
        return ExportedPolicy(
            policy=policy,
            actuators=_actuators(arrays, metadata, policy.action_size),
            sensors=_sensors(arrays, metadata, sizes["observation_size"]),
            start=Latent(start_mean, take(arrays, "start.log_std", size)),
            rule=LearningRule(
                mean_step=take(arrays, "rule.mean_step", size),
                log_std_step=take(arrays, "rule.log_std_step", size),
                full_steps=entry(rule, "full_steps", int),
                factor=entry(rule, "factor", float),
                discount=entry(rule, "discount", float),
                ridge=entry(rule, "ridge", float),
            ),
            description=entry(metadata, "description", dict),
            start_update=entry(metadata, "start_update", int),
            search=_search(arrays, metadata, size),
            is_noisy=_is_noisy(entry(metadata, "is_noisy", dict)),
        )


def _is_noisy(flags: dict[str, Any]) -> dict[Purpose, bool]:
    return {purpose: entry(flags, purpose, bool) for purpose in PURPOSES}


def _names(metadata: Mapping[str, Any], kind: str, size: int) -> tuple[str, ...]:
    names = entry(metadata, kind, list)
    if len(names) != size or not all(isinstance(name, str) for name in names):
        raise ValueError(f"entry `{kind}` must be {size} names, got {names!r}.")
    return tuple(names)


def _sensors(
    arrays: Mapping[str, NDArray[np.generic]], metadata: Mapping[str, Any], size: int
) -> Sensors:
    return Sensors(
        _names(metadata, "sensors", size),
        lower=take(arrays, "sensors.lower", size, allow_infinite=True),
        upper=take(arrays, "sensors.upper", size, allow_infinite=True),
    )


def _actuators(
    arrays: Mapping[str, NDArray[np.generic]], metadata: Mapping[str, Any], size: int
) -> Actuators:
    return Actuators(
        offset=take(arrays, "actuators.offset", size),
        scale=take(arrays, "actuators.scale", size),
        lower=take(arrays, "actuators.lower", size, allow_infinite=True),
        upper=take(arrays, "actuators.upper", size, allow_infinite=True),
        names=_names(metadata, "actuators", size),
    )


def _search(
    arrays: Mapping[str, NDArray[np.generic]], metadata: Mapping[str, Any], size: int
) -> ExportedSearch | None:
    if _SEARCH not in metadata:
        return None
    return ExportedSearch.from_archive(arrays, entry(metadata, _SEARCH, dict), size)
