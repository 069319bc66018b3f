"""The fast learner that plays one latent per update, as a strategy chooses it."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from maesn.axes import TaskKeys
from maesn.context import Latent
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner, Purpose, SavedContexts
from maesn.learners.base import refuse_saved
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import AbstractPolicy
from maesn.runtime.arrays import FloatArray
from maesn.search.strategies import AbstractStrategy


@dataclass(frozen=True)
class StrategyState:
    """Of all tasks: the strategies, the latent that each plays next, and its random numbers."""

    strategies: tuple[AbstractStrategy, ...]
    chosen: tuple[FloatArray, ...]
    generators: tuple[np.random.Generator, ...]


class StrategyFastLearner(AbstractFastLearner[StrategyState]):
    """Plays the latent that a strategy proposes, in all episodes of an update."""

    policy: AbstractPolicy
    statistics: ObservationStatistics | None
    start: AbstractStrategy

    def init(self, keys: TaskKeys, saved: SavedContexts | None = None) -> StrategyState:
        refuse_saved(self, saved)
        generators = task_generators(keys)
        return _next([self.start] * len(generators), generators)

    def agents(self, state: StrategyState, purpose: Purpose = "explore") -> Agents:
        context = _latents(state.chosen) if purpose == "explore" else self.adapted(state)
        return Agents(
            self.policy, context.at_mean(), shares_policy=True, statistics=self.statistics
        )

    def adapted(self, state: StrategyState) -> Latent:
        """Return the latents that would be deployed."""
        return _latents([strategy.deployed for strategy in state.strategies])

    def update(self, state: StrategyState, episodes: Episodes) -> StrategyState:
        returns = np.asarray(episodes.undiscounted_return, np.float64).mean(axis=1)
        played = zip(state.strategies, state.chosen, returns.tolist(), strict=True)
        moved = [strategy.after(z, mean_return) for strategy, z, mean_return in played]
        return _next(moved, state.generators)


def task_generators(keys: TaskKeys) -> tuple[np.random.Generator, ...]:
    """Return NumPy's random numbers of each task, which depend on the task's key alone."""
    words = np.asarray(jax.vmap(jax.random.key_data)(keys))
    return tuple(np.random.default_rng(row.tolist()) for row in words)


def _latents(chosen: Sequence[FloatArray]) -> Latent:
    mean = jnp.asarray(np.stack(chosen), jnp.float32)
    return Latent(mean, jnp.zeros_like(mean))


def _next(
    strategies: Sequence[AbstractStrategy], generators: tuple[np.random.Generator, ...]
) -> StrategyState:
    pairs = zip(strategies, generators, strict=True)
    chosen = tuple(strategy.proposed(generator) for strategy, generator in pairs)
    return StrategyState(tuple(strategies), chosen, generators)
