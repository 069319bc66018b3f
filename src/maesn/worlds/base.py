"""Worlds: many episodes of a family at once.

A world joins an environment (pure functions of one episode), a finite set of tasks, and an engine
that moves states. It plays a whole batch of episodes with given policies, and returns readings and
actions of every step. Rewards, observations and masks are pure functions of the readings:
`maesn.worlds.collector` computes them once for the whole batch.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from maesn.axes import HostReadings, Readings, RecurrentState
from maesn.envs.base import AnyEnv
from maesn.envs.tasks import TaskSet
from maesn.experience.agent import Agents, TrialState
from maesn.numerics import AbstractDistribution


class Actors(eqx.Module):
    """The agents of a batch of episodes, and all else that is constant during it."""

    agents: Agents
    tasks: Any
    """Task pytree with a leading `task` axis."""
    noise: Float[Array, "task episode noise"]
    description: Float[Array, "task episode description"]
    z: Float[Array, "task episode z"]
    action_noise: Float[Array, "time task episode action"]
    """Noise of the actions, drawn for all steps at once."""
    trial_state: TrialState
    """State from which the trials continue, `[task, episode, ...]`."""


class Decision(NamedTuple):
    """The policies' output at one step of every episode."""

    control: Float[Array | np.ndarray, "simulation control"]
    action: Float[Array, "task episode action"]
    behaviour: AbstractDistribution
    recurrent_state: RecurrentState
    ended: Bool[Array, "task episode"]
    """Whether the episode has terminated, in this state or in an earlier one."""


class Moment(NamedTuple):
    """The policies' input at step t of every episode; NumPy arrays from host worlds."""

    step: Int[Array | np.ndarray, ""]
    readings: Readings | HostReadings
    """`[simulation, ...]` each."""
    previous_readings: Readings | HostReadings
    previous_action: Float[Array | np.ndarray, "task episode action"]
    recurrent_state: RecurrentState
    ended: Bool[Array | np.ndarray, "task episode"]
    """`Decision.ended` of the step before; False at the start."""


Act: TypeAlias = Callable[[Actors, Moment], Decision]
"""Calls the policies for one step of a batch of episodes."""


class Trajectory(NamedTuple):
    """Readings and actions of all episodes, time first."""

    readings: Readings | HostReadings
    """`[time_plus_1, simulation, ...]` each."""
    action: Float[Array | np.ndarray, "time task episode action"]
    behaviour: AbstractDistribution
    """`[time, task, episode, action]`."""
    recurrent_state: RecurrentState
    """State after the last step, `[task, episode, ...]`."""


class EpisodeError(RuntimeError):
    """An episode went wrong; the message names environment, task, episode and step."""

    def __init__(
        self, env: str, task: int, episode: int, step: int, reason: str, updates: int = 0
    ) -> None:
        when = f" (after update {updates} in this task)" if updates else ""
        super().__init__(f"{env}, task {task}, episode {episode}, step {step}: {reason}{when}")
        self._origin = (env, task, episode, step, reason)

    def after(self, updates: int) -> "EpisodeError":
        """Return the same error, which also says how often the agent had been updated."""
        return EpisodeError(*self._origin, updates)


class EnvContractError(ValueError):
    """A function of an environment does not fit what it declares; the message names both."""


class SimulationFailure(RuntimeError):
    """Some simulations of a batch failed at one step; the collector names their episodes."""

    def __init__(self, simulation: int, step: int, reason: str) -> None:
        super().__init__(f"simulation {simulation}, step {step}: {reason}")
        self.simulation = simulation
        self.step = step
        self.reason = reason


class AbstractWorld(ABC):
    """A family's tasks, ready to be played in batches."""

    env: AnyEnv
    """The environment that is played."""
    tasks: TaskSet
    """The tasks that can be played."""

    max_simulations: int | None = None
    """Largest number of simulations to play at once; None for any number."""

    @abstractmethod
    def play(self, act: Act, actors: Actors, start: Any) -> Trajectory:
        """Play one episode of `env.horizon` steps in every simulation.

        Args:
            act: pure function that decides each step. Passing the same object again avoids a
                second compilation.
            actors: the agents of all episodes.
            start: the starts that `env.start` returns, stacked over `simulation`.

        Raises:
            SimulationFailure: the physics of a simulation blew up during its episode, or a foreign
                environment broke its contract.
        """

    pictures: Sequence[Sequence[UInt8[np.ndarray, "height width 3"]]] = ()
    """Pictures of the last episodes, `[time][simulation]`, if `film` has returned True."""

    def film(self, shown: int, stride: int, size: tuple[int, int]) -> bool:
        """From now on, keep the environments' own drawings of themselves in `pictures`.

        Args:
            shown: number of simulations to film, the first ones of each batch.
            stride: steps from one picture to the next. The last state always has one.
            size: width and height of the pictures, in pixels.

        Returns:
            Whether the environments draw themselves. Only foreign ones can; `maesn.worlds.Scene`
            draws the states of all others.

        Raises:
            WorkerError: an environment cannot be used.
        """
        return False

    @abstractmethod
    def close(self) -> None:
        """Stop the threads and processes that play; playing again would start them anew."""
