"""Controls of a search: one knows mean and variance of the training tasks, one has no model."""

from dataclasses import replace
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from maesn.axes import TaskKeys
from maesn.context import AbstractContext
from maesn.envs import AnyEnv
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner, AbstractSettableLatent, Purpose
from maesn.rules.base import AbstractRule, Budget, Trained
from maesn.rules.search import SearchRule
from maesn.runtime.return_model import ReturnModel, ReturnPrior
from maesn.search import SearchSettings, latent_of


class StationaryRule(SearchRule):
    """Search as `search` does, with one Gaussian process that knows no training task.

    Its mean is the average over training tasks, its kernel stationary with their variance.
    """

    settings: SearchSettings = SearchSettings(familiar=1.0)

    @property
    def label(self) -> str:
        return "stationary process"

    def model(self, prior: ReturnPrior) -> ReturnModel:
        return self.settings.model(prior).unlike(wider=1.0, shifted=False)


class RandomRule(AbstractRule):
    """Play latents drawn at random; deploy the one with the highest return so far.

    Before the first episode, latent 0 is deployed.
    """

    budget: ClassVar[Budget] = Budget(20, 1, 5)

    spread: float = 1.0
    """Standard deviation of the draws; 1 is the prior of MAESN."""

    @property
    def label(self) -> str:
        return "random latents"

    def fast_learner(self, trained: Trained, env: AnyEnv) -> "RandomLatents":
        return RandomLatents(latent_of(trained.fast_learner()), self.spread)


class RandomState(eqx.Module):
    """State of `RandomLatents`: one number of updates, and an element per task of all else."""

    keys: TaskKeys
    best: Float[Array, "task z"]
    best_return: Float[Array, " task"]
    played: Int[Array, ""]


class RandomLatents(AbstractFastLearner[RandomState]):
    """Draws a latent for each update, and remembers the best."""

    steered: AbstractSettableLatent
    spread: float

    def init(self, keys: TaskKeys) -> RandomState:
        nothing = jnp.zeros((len(keys), self.steered.size))
        return RandomState(keys, nothing, jnp.full(len(keys), -jnp.inf), jnp.zeros((), int))

    def agents(self, state: RandomState, purpose: Purpose = "explore") -> Agents:
        latents = state.best if purpose == "deploy" else self._drawn(state)
        return replace(self.steered.holding(latents), is_noisy=False)  # as in a search

    def adapted(self, state: RandomState) -> AbstractContext:
        """Return the latents to deploy."""
        return self.agents(state, "deploy").context

    def update(self, state: RandomState, episodes: Episodes) -> RandomState:
        returns = episodes.undiscounted_return.mean(-1)
        is_better = returns > state.best_return
        best = jnp.where(is_better[:, None], self._drawn(state), state.best)
        most = jnp.maximum(returns, state.best_return)
        return RandomState(state.keys, best, most, state.played + 1)

    def _drawn(self, state: RandomState) -> Float[Array, "task z"]:
        keys = jax.vmap(jax.random.fold_in, (0, None))(state.keys, state.played)
        draw = partial(jax.random.normal, shape=(self.steered.size,))
        return self.spread * jax.vmap(draw)(keys)
