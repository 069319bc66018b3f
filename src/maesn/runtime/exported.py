"""The result of meta-training that a robot loads. It does not change there."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from maesn.runtime.actuators import Actuators
from maesn.runtime.archive import entry
from maesn.runtime.arrays import Arrays, named, take, taken
from maesn.runtime.episode import PURPOSES, Purpose
from maesn.runtime.exported_search import ExportedSearch
from maesn.runtime.latent import LATENT, Latent, LearningRule
from maesn.runtime.policy import GaussianPolicy
from maesn.runtime.sensors import Sensors

_SEARCH = "search"
# Fields that a file holds under their own names.
_MAP, _LIMITS, _STEPS = ("offset", "scale"), ("lower", "upper"), ("mean_step", "log_std_step")
_NUMBERS: dict[str, type] = {"full_steps": int, "factor": float, "discount": float, "ridge": float}


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
        arrays = self.policy.arrays()
        arrays |= named("actuators", self.actuators, *_MAP, *_LIMITS)
        arrays |= named("sensors", self.sensors, *_LIMITS)
        arrays |= named("start", self.start, *LATENT)
        arrays |= named("rule", self.rule, *_STEPS)
        return arrays if self.search is None else arrays | self.search.arrays()

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
            "rule": {name: getattr(self.rule, name) for name in _NUMBERS},
            **({} if self.search is None else {_SEARCH: self.search.metadata()}),
        }

    @staticmethod
    def from_archive(arrays: Arrays, metadata: Mapping[str, Any]) -> "ExportedPolicy":
        """Rebuild a saved policy; raises ValueError if a part is missing or does not fit."""
        size = take(arrays, "start.mean", -1).shape[0]
        inputs, layers = (entry(metadata, name, int) for name in ("observation_size", "num_layers"))
        if min(inputs, layers) < 1:
            raise ValueError(
                f"entries `observation_size` {inputs} and `num_layers` {layers} must be at least 1."
            )
        policy = GaussianPolicy.from_arrays(arrays, inputs + size, layers)
        outputs, rule = policy.action_size, entry(metadata, "rule", dict)
        is_noisy, search = entry(metadata, "is_noisy", dict), None
        if _SEARCH in metadata:
            search = ExportedSearch.from_archive(arrays, entry(metadata, _SEARCH, dict), size)
        return ExportedPolicy(
            policy,
            Actuators(
                **taken(arrays, "actuators", outputs, *_MAP),
                **taken(arrays, "actuators", outputs, *_LIMITS, allow_infinite=True),
                names=_names(metadata, "actuators", outputs),
            ),
            Sensors(
                **taken(arrays, "sensors", inputs, *_LIMITS, allow_infinite=True),
                names=_names(metadata, "sensors", inputs),
            ),
            Latent(**taken(arrays, "start", size, *LATENT)),
            LearningRule(
                **taken(arrays, "rule", size, *_STEPS),
                **{name: entry(rule, name, kind) for name, kind in _NUMBERS.items()},
            ),
            description=entry(metadata, "description", dict),
            start_update=entry(metadata, "start_update", int),
            search=search,
            is_noisy={purpose: entry(is_noisy, purpose, bool) for purpose in PURPOSES},
        )


def _names(metadata: Mapping[str, Any], kind: str, size: int) -> tuple[str, ...]:
    names = entry(metadata, kind, list)
    if len(names) != size or not all(isinstance(name, str) for name in names):
        raise ValueError(f"entry `{kind}` must be {size} names, got {names!r}.")
    return tuple(names)
