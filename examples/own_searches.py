"""Adaptation rules of your own: three searches for a good latent that use the returns alone.

    export PYTHONPATH=examples
    maesn adapt wheeled --rule own_searches:BestOf
    maesn adapt wheeled --rule own_searches:CrossEntropy spread=2 round_size=10
    maesn adapt wheeled --rule own_searches:CmaEs               # needs `pip install cmaes`

They know nothing of the training tasks, and serve as a comparison with `--rule search`. Each plays
one latent per update. `examples/few_episodes.toml` is a study that names one of them.
"""

import copy
from abc import abstractmethod
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any, ClassVar, NamedTuple

import jax
import numpy as np

import maesn


class AbstractSearch(maesn.AbstractRule):
    """Draws latents one after the other, in each task by itself.

    `memory` is what a search remembers of one task. It is never changed: `after` returns a new one.
    """

    budget: ClassVar[maesn.Budget] = maesn.Budget(episodes=100, per_update=1, deploy=5)

    @abstractmethod
    def start(self, size: int) -> Any:
        """Return the memory before any episode; latents have so many components."""

    @abstractmethod
    def propose(self, memory: Any, generator: np.random.Generator) -> np.ndarray:
        """Draw the latent to play next, `[z]`."""

    @abstractmethod
    def after(self, memory: Any, z: np.ndarray, mean_return: float) -> Any:
        """Return the memory after one more latent was played."""

    @abstractmethod
    def deployed(self, memory: Any) -> np.ndarray:
        """Return the latent to deploy, `[z]`."""

    def fast_learner(self, trained: maesn.Trained, env: Any) -> "SearchLearner":
        latent = trained.fast_learner().latent
        if latent is None:
            raise ValueError("a search needs a policy with a latent, as that of `maesn`.")
        return SearchLearner(latent, self)


class BestOf(AbstractSearch):
    """Play draws from N(0, spread^2 I); deploy the one with the highest return so far.

    Every latent is played once, so the best of many may owe its rank to chance.
    """

    spread: float = 1.0
    """Standard deviation of the draws."""

    def start(self, size: int) -> tuple[np.ndarray, float]:
        return np.zeros(size), -np.inf

    def propose(self, memory: Any, generator: np.random.Generator) -> np.ndarray:
        return self.spread * generator.standard_normal(len(memory[0]))

    def after(self, memory: Any, z: np.ndarray, mean_return: float) -> tuple[np.ndarray, float]:
        return (z, mean_return) if mean_return > memory[1] else memory

    def deployed(self, memory: Any) -> np.ndarray:
        return memory[0]


class Round(NamedTuple):
    """A Gaussian that a round of latents is drawn from, and those of the round so far."""

    mean: np.ndarray
    std: np.ndarray
    played: tuple[tuple[np.ndarray, float], ...] = ()


class CrossEntropy(AbstractSearch):
    """The cross-entropy method: draw in rounds, each around the best of the round before.

    Rubinstein 1999, "The cross-entropy method for combinatorial and continuous optimization". The
    mean of the draws is deployed.
    """

    spread: float = 3.0
    """Standard deviation of the first draws: that of the archive of `search`."""
    round_size: int = 20
    """Draws per round."""
    elite: float = 0.2
    """Share of a round that the next one is fitted to, at least two draws."""
    least_std: float = 0.05
    """Added to the standard deviation in every round: the draws must not collapse too early."""

    def start(self, size: int) -> Round:
        return Round(np.zeros(size), np.full(size, self.spread))

    def propose(self, memory: Round, generator: np.random.Generator) -> np.ndarray:
        return memory.mean + memory.std * generator.standard_normal(len(memory.mean))

    def after(self, memory: Round, z: np.ndarray, mean_return: float) -> Round:
        played = (*memory.played, (z, mean_return))
        if len(played) < self.round_size:
            return memory._replace(played=played)
        ranked = sorted(played, key=lambda one: -one[1])
        best = np.stack([z for z, _ in ranked[: max(int(self.elite * self.round_size), 2)]])
        return Round(best.mean(axis=0), best.std(axis=0) + self.least_std)

    def deployed(self, memory: Round) -> np.ndarray:
        return memory.mean


class Generation(NamedTuple):
    """`cmaes.CMA`, which is copied before anything in it changes, and what it awaits."""

    optimizer: Any
    played: tuple[tuple[np.ndarray, float], ...] = ()


class CmaEs(AbstractSearch):
    """CMA-ES, by the library `cmaes`. The mean of the draws is deployed.

    Hansen 2016, "The CMA evolution strategy: a tutorial".
    """

    spread: float = 3.0
    """Standard deviation of the first draws: that of the archive of `search`."""
    population: int | None = None
    """Draws per generation; None: the library's default for the size of z, 6 for two components."""

    def __check_init__(self) -> None:
        if find_spec("cmaes") is None:
            raise ValueError("it needs the library `cmaes`: pip install cmaes.")

    def start(self, size: int) -> Generation:
        library, zero = import_module("cmaes"), np.zeros(size)
        # This seed has no effect: `propose` seeds every draw.
        return Generation(library.CMA(zero, self.spread, seed=0, population_size=self.population))

    def propose(self, memory: Generation, generator: np.random.Generator) -> np.ndarray:
        optimizer = copy.deepcopy(memory.optimizer)
        optimizer.reseed_rng(int(generator.integers(2**32)))
        return optimizer.ask()

    def after(self, memory: Generation, z: np.ndarray, mean_return: float) -> Generation:
        played = (*memory.played, (z, -mean_return))  # the library minimises
        if len(played) < memory.optimizer.population_size:
            return Generation(memory.optimizer, played)
        optimizer = copy.deepcopy(memory.optimizer)
        optimizer.tell(list(played))
        return Generation(optimizer)

    def deployed(self, memory: Generation) -> np.ndarray:
        return memory.optimizer.mean


class SearchState(NamedTuple):
    """One element per task."""

    memories: Sequence[Any]
    chosen: Sequence[np.ndarray]
    """The latents to play next."""
    generators: Sequence[np.random.Generator]


class SearchLearner(maesn.AbstractFastLearner[SearchState]):
    """Plays the latent that a search proposes in all episodes until the next update."""

    steered: maesn.AbstractSettableLatent
    search: AbstractSearch

    def init(self, keys: jax.Array) -> SearchState:
        seeds = np.asarray(jax.vmap(jax.random.key_data)(keys))
        generators = [np.random.default_rng(seed.tolist()) for seed in seeds]
        return self.proposed([self.search.start(self.steered.size)] * len(seeds), generators)

    def agents(self, state: SearchState, purpose: str = "explore") -> maesn.Agents:
        chosen = state.chosen if purpose == "explore" else self.deployed(state)
        return self.steered.holding(np.asarray(chosen, np.float32))

    def adapted(self, state: SearchState) -> maesn.AbstractContext:
        """Return the latents to deploy."""
        return self.agents(state, "deploy").context

    def update(self, state: SearchState, episodes: maesn.Episodes) -> SearchState:
        returns = np.asarray(episodes.undiscounted_return, np.float64).mean(axis=1).tolist()
        played = zip(state.memories, state.chosen, returns, strict=True)
        return self.proposed([self.search.after(*one) for one in played], state.generators)

    def deployed(self, state: SearchState) -> list[np.ndarray]:
        return [self.search.deployed(memory) for memory in state.memories]

    def proposed(
        self, memories: Sequence[Any], generators: Sequence[np.random.Generator]
    ) -> SearchState:
        """Return the state in which every task has drawn the latent to play next."""
        own = copy.deepcopy(generators)  # those of the state before stay as they are
        chosen = [self.search.propose(*one) for one in zip(memories, own, strict=True)]
        return SearchState(memories, chosen, own)
