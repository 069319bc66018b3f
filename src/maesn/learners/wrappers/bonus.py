"""A curiosity bonus for any fast learner: it learns from the sum of reward and bonus."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from maesn.axes import Key, TaskKeys
from maesn.context import AbstractContext
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners.fast import AbstractFastLearner, Capabilities, Purpose
from maesn.learners.wrappers.curiosity import CuriosityBonus, CuriosityState
from maesn.numerics.tasks import map_tasks

# For functions of the settings alone: a user's learner need not be anything that JAX can trace.
_compiled = eqx.filter_jit(map_tasks)


class BonusFastState(eqx.Module):
    """State of a `BonusFastLearner`."""

    learner: Any
    curiosity: CuriosityState
    """One model per task."""
    keys: TaskKeys
    """One key per task, for all later draws."""
    update: Int[Array, ""]
    """Number of updates so far."""


class BonusFastLearner(AbstractFastLearner[BonusFastState]):
    """A fast learner with a curiosity bonus, from one model of the dynamics per task.

    With TRPO from scratch this is VIME.
    """

    learner: AbstractFastLearner[Any]
    """The learner that gets the bonus."""
    curiosity: CuriosityBonus
    """Settings of the bonus."""
    observation_size: int
    """Components of an observation."""
    action_size: int
    """Components of an action, or number of choices."""
    trained: CuriosityState | None = None
    """The initial model of every task; None for untrained models."""

    def __check_init__(self) -> None:
        can = self.learner.capabilities
        if not can.learns_from_reward:
            raise ValueError(
                f"`learner` must learn from the sum of reward and bonus, which "
                f"{type(self.learner).__name__} does not read: a bonus would change nothing."
            )
        if can.has_bonus:
            raise ValueError("`learner` must not have a bonus already: it would be added twice.")

    def init(self, keys: TaskKeys) -> BonusFastState:
        learner_keys, model_keys, keys = jnp.moveaxis(
            jax.vmap(lambda key: jax.random.split(key, 3))(keys), 1, 0
        )
        models = map_tasks(self._initial_model, model_keys, how="vmap")
        learner = self.learner.init(learner_keys)
        return BonusFastState(learner, models, keys, jnp.zeros((), int))

    def agents(self, state: BonusFastState, purpose: Purpose = "explore") -> Agents:
        return self.learner.agents(state.learner, purpose)

    def adapted(self, state: BonusFastState) -> AbstractContext:
        return self.learner.adapted(state.learner)

    @property
    def capabilities(self) -> Capabilities:
        return self.learner.capabilities._replace(has_bonus=True)

    def inside(
        self, change: Callable[[AbstractFastLearner[Any]], AbstractFastLearner[Any]]
    ) -> "BonusFastLearner":
        return dataclasses.replace(self, learner=self.learner.inside(change))

    def update(self, state: BonusFastState, episodes: Episodes) -> BonusFastState:
        """Learn from reward and bonus, then let the models learn from the transitions."""
        folded = jax.vmap(jax.random.fold_in, in_axes=(0, None))(state.keys, state.update)
        keys = jax.vmap(jax.random.split)(folded)
        # In turn, to bound the memory: every transition has a gradient of its own.
        models, bonus = _compiled(
            self.curiosity.judge, keys[:, 0], state.curiosity, episodes, how="serial"
        )
        rewarded = dataclasses.replace(
            episodes,
            reward=episodes.reward + bonus,
            # What the policy received while it played has no bonus.
            observed_reward=episodes.received_reward,
        )
        learned = self.learner.update(state.learner, rewarded)
        models = _compiled(self.curiosity.learn, keys[:, 1], models, how="vmap")
        return BonusFastState(learned, models, state.keys, state.update + 1)

    def _initial_model(self, key: Key) -> CuriosityState:
        if self.trained is not None:
            return self.curiosity.start(self.trained)
        return self.curiosity.init(key, self.observation_size, self.action_size)
