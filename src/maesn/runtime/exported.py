"""The result of meta-training that a robot loads. It does not change there."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from maesn.runtime.actuators import Actuators
from maesn.runtime.arrays import check_shapes
from maesn.runtime.episode import PURPOSES, Purpose
from maesn.runtime.latent import Latent, LearningRule
from maesn.runtime.policy import GaussianPolicy
from maesn.runtime.return_model import ReturnModel, ReturnPrior
from maesn.runtime.search import SearchSettings
from maesn.runtime.sensors import Sensors


class ExportedLearner(NamedTuple):
    """What a learner brings to an `ExportedPolicy`; the rest comes from its environment."""

    policy: GaussianPolicy
    """Its weights do not change on the robot."""
    start: Latent
    """The latent that a new task starts from."""
    rule: LearningRule
    """The policy-gradient update of the latent."""


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

    def __post_init__(self) -> None:
        if self.horizon < 1:
            raise ValueError(f"`horizon` must be at least 1, got {self.horizon}.")

    @cached_property
    def model(self) -> ReturnModel:
        """The model of returns."""
        return self.settings.model(self.prior)


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

    Raises:
        ValueError: the parts do not fit each other.
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

    def __post_init__(self) -> None:
        latent, action = (self.latent_size,), (self.action_size,)
        if min(self.latent_size, self.observation_size) < 1:
            raise ValueError(
                f"`policy` has {self.policy.input_size} inputs for an observation and a z of "
                f"{self.latent_size} components."
            )
        check_shapes(self.start, latent, "mean", "log_std")
        check_shapes(self.rule, latent, "mean_step", "log_std_step")
        check_shapes(self.actuators, action, "offset", "scale", "lower", "upper", "names")
        check_shapes(self.sensors, (self.observation_size,), "lower", "upper", "names")
        if self.search is not None:
            prior = self.search.prior
            check_shapes(prior, (len(prior.noise), *latent), "latents")
        if {*self.is_noisy} != {*PURPOSES}:
            raise ValueError(f"`is_noisy` must be stated for {PURPOSES}, got {self.is_noisy}.")

    @property
    def latent_size(self) -> int:
        """Number of components of z."""
        return self.start.mean.size

    @property
    def observation_size(self) -> int:
        """Number of components of an observation."""
        return self.policy.input_size - self.latent_size

    @property
    def action_size(self) -> int:
        """Number of components of an action, and of a control."""
        return self.policy.std.size

    @property
    def search_horizon(self) -> int:
        """Steps of a full episode, which a search alone needs; 1 without one."""
        return 1 if self.search is None else self.search.horizon
