"""The fast learner in which a search strategy chooses one latent per update."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np

from maesn.axes import TaskKeys
from maesn.context import AbstractContext
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner, AbstractSettableLatent, Purpose
from maesn.runtime.arrays import FloatArray
from maesn.search.strategies import AbstractStrategy


@dataclass(frozen=True)
class StrategyState:
    """State of a `StrategyFastLearner`, one element per task."""

    strategies: tuple[AbstractStrategy, ...]
    chosen: tuple[FloatArray, ...]
    """The latents to play next, `[z]` each."""
    generators: tuple[np.random.Generator, ...]


class StrategyFastLearner(AbstractFastLearner[StrategyState]):
    """Plays the latent that a strategy proposes in all episodes until the next update."""

    steered: AbstractSettableLatent
    """The latent that the strategy chooses."""
    start: AbstractStrategy

    def init(self, keys: TaskKeys) -> StrategyState:
        generators = task_generators(keys)
        return _propose([self.start] * len(generators), generators)

    def agents(self, state: StrategyState, purpose: Purpose = "explore") -> Agents:
        chosen = state.chosen if purpose == "explore" else _deployed(state)
        return self.steered.holding(np.asarray(chosen, np.float32))

    def adapted(self, state: StrategyState) -> AbstractContext:
        """Return the latents to deploy."""
        return self.steered.holding(np.asarray(_deployed(state), np.float32)).context

    def update(self, state: StrategyState, episodes: Episodes) -> StrategyState:
        mean_returns = np.asarray(episodes.undiscounted_return, np.float64).mean(axis=1).tolist()
        strategies = [
            strategy.after(z, mean_return)
            for strategy, z, mean_return in zip(
                state.strategies, state.chosen, mean_returns, strict=True
            )
        ]
        return _propose(strategies, state.generators)


def task_generators(keys: TaskKeys) -> tuple[np.random.Generator, ...]:
    """Return a NumPy generator for each task, seeded with the task's key alone."""
    words = np.asarray(jax.vmap(jax.random.key_data)(keys))
    return tuple(np.random.default_rng(row.tolist()) for row in words)


def _deployed(state: StrategyState) -> tuple[FloatArray, ...]:
    return tuple(strategy.deployed for strategy in state.strategies)


def _propose(
    strategies: Sequence[AbstractStrategy], generators: tuple[np.random.Generator, ...]
) -> StrategyState:
    """Return the state in which each strategy has drawn the latent to play next."""
    generators = copy.deepcopy(generators)  # those of the state before stay as they are
    pairs = zip(strategies, generators, strict=True)
    chosen = tuple(strategy.proposed(generator) for strategy, generator in pairs)
    return StrategyState(tuple(strategies), chosen, generators)
