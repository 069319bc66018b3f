"""Curiosity for any learner: it is handed the episodes with a bonus added to their rewards."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from maesn.axes import ActionKind, Key, TaskKeys
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes, TrialState
from maesn.experience.transitions import check_observed
from maesn.learners.base import AbstractFastLearner, AbstractMetaLearner
from maesn.learners.side_by_side import side_by_side
from maesn.learners.wrappers.curiosity import CuriosityBonus, CuriosityState


class BonusFastState(eqx.Module):
    """State of a `BonusFastLearner`."""

    learner: Any
    curiosity: CuriosityState
    """One model per task."""
    keys: TaskKeys
    """Of all further draws of each task."""
    update: Int[Array, ""]
    """Number of updates so far."""


class BonusFastLearner(AbstractFastLearner[BonusFastState]):
    """A fast learner that is paid for what each task's model of the dynamics finds out.

    With TRPO from scratch this is VIME.
    """

    learner: AbstractFastLearner[Any]
    """Learns from reward and bonus."""
    curiosity: CuriosityBonus
    """What it is paid."""
    observation_size: int
    """Components of an observation."""
    action_size: int
    """Components of an action, or number of choices."""
    known: CuriosityState | None = None
    """What the models know at the start; None for nothing."""

    def __check_init__(self) -> None:
        if not self.learner.learns_from_reward:
            raise ValueError(
                f"`learner` must learn from what it is paid to be curious, which "
                f"{type(self.learner).__name__} does not."
            )
        if self.learner.has_bonus:
            raise ValueError("`learner` must not be curious already: it would be paid twice.")
        check_observed(self.observation_size)

    def init(self, keys: TaskKeys) -> BonusFastState:
        learner_keys, model_keys, keys = jnp.moveaxis(
            jax.vmap(lambda key: jax.random.split(key, 3))(keys), 1, 0
        )
        models = jax.vmap(self._fresh)(model_keys)
        learner = self.learner.init(learner_keys)
        return BonusFastState(learner, models, keys, jnp.zeros((), int))

    def agents(self, state: BonusFastState) -> Agents:
        return self.learner.agents(state.learner)

    def memory(self, state: BonusFastState) -> TrialState | None:
        return self.learner.memory(state.learner)

    def episodes_per_update(self, episodes_per_task: int) -> int:
        return self.learner.episodes_per_update(episodes_per_task)

    @property
    def trial_episodes(self) -> int | None:
        return self.learner.trial_episodes

    @property
    def is_recurrent(self) -> bool:
        return self.learner.is_recurrent

    @property
    def has_bonus(self) -> bool:
        return True

    def paced(self, step_scale: float, full_steps: int | None) -> "BonusFastLearner":
        """See `AbstractFastLearner.paced`; the steps are those of the learner that is paid."""
        return self.inside(lambda learner: learner.paced(step_scale, full_steps))

    def inside(
        self, change: Callable[[AbstractFastLearner[Any]], AbstractFastLearner[Any]]
    ) -> "BonusFastLearner":
        """See `AbstractFastLearner.inside`; what is changed is paid as before."""
        return dataclasses.replace(self, learner=self.learner.inside(change))

    def update(self, state: BonusFastState, episodes: Episodes) -> BonusFastState:
        """Learn from reward and bonus, then let the models learn from what was seen."""
        keys = _split_each(state.keys, state.update)
        paid, bonus = self._pay(keys[:, 0], state.curiosity, episodes)
        learned, models = side_by_side(
            lambda: self.learner.update(state.learner, _with_bonus(episodes, bonus)),
            lambda: self._learn(keys[:, 1], paid),
        )
        return BonusFastState(learned, models, state.keys, state.update + 1)

    def _fresh(self, key: Key) -> CuriosityState:
        if self.known is not None:
            return self.curiosity.start(self.known)
        return self.curiosity.init(key, self.observation_size, self.action_size)

    @eqx.filter_jit
    def _pay(
        self, keys: TaskKeys, models: CuriosityState, episodes: Episodes
    ) -> tuple[CuriosityState, Float[Array, "task episode time"]]:
        # One task after the other: the gradients of single transitions are large.
        return jax.lax.map(lambda x: self.curiosity.pay(*x), (keys, models, episodes))

    @eqx.filter_jit
    def _learn(self, keys: TaskKeys, models: CuriosityState) -> CuriosityState:
        return jax.vmap(self.curiosity.learn)(keys, models)


class BonusMetaState(eqx.Module):
    """State of a `BonusMetaLearner`."""

    learner: Any
    curiosity: CuriosityState
    """One model for all tasks, whose dynamics are the same."""


class BonusInfo(eqx.Module):
    """What a person wants to know of the curiosity of one meta-iteration."""

    bonus: Float[Array, ""]
    """Mean bonus of an episode in the last collection."""
    typical_gain: Float[Array, ""]
    """Mean of the last median information gains, in nats for a step of size 1."""


class BonusMetaLearner(AbstractMetaLearner[BonusMetaState, dict[str, Any]]):
    """A meta-learner that is paid for what one model of the dynamics finds out.

    Every collection of a meta-iteration is paid by the model of its beginning; at its end the
    model learns. What is learned of the dynamics passes on to new tasks.
    """

    learner: AbstractMetaLearner[Any, Any]
    """Learns from reward and bonus."""
    curiosity: CuriosityBonus = CuriosityBonus()
    """What the bonus is."""

    def __check_init__(self) -> None:
        if type(self) in self.learner.slots():
            raise ValueError("`learner` must not be curious already: it would be paid twice.")

    def init(
        self,
        key: Key,
        observation_size: int,
        action_size: int,
        num_tasks: int,
        description_size: int = 0,
    ) -> BonusMetaState:
        learner_key, model_key = jax.random.split(key)
        sizes = observation_size, action_size, num_tasks, description_size
        return BonusMetaState(
            self.learner.init(learner_key, *sizes),
            self.curiosity.init(model_key, observation_size, action_size),
        )

    def iteration(self, state: BonusMetaState) -> Int[Array, ""]:
        return self.learner.iteration(state.learner)

    def for_actions(self, kind: ActionKind) -> "BonusMetaLearner":
        """See `AbstractMetaLearner.for_actions`."""
        return dataclasses.replace(self, learner=self.learner.for_actions(kind))

    def check_batch(self, episodes_per_task: int) -> None:
        """See `AbstractMetaLearner.check_batch`."""
        self.learner.check_batch(episodes_per_task)

    def slots(self) -> tuple[Any, ...]:
        """Return those of the learner, which is another method if it is curious."""
        return (type(self), *self.learner.slots())

    def fast_learner(self, state: BonusMetaState) -> AbstractFastLearner[Any]:
        """Return the learner of new tasks; its models begin with what this one knows.

        A learner whose updates do not depend on rewards has no use for a bonus, and comes as it is.
        """
        learner, network = self.learner.fast_learner(state.learner), state.curiosity.network
        if not learner.learns_from_reward:
            return learner
        return BonusFastLearner(
            learner=learner,
            curiosity=self.curiosity,
            observation_size=network.output_size,
            action_size=network.input_size - network.output_size,
            known=state.curiosity,
        )

    def step(
        self, key: Key, state: BonusMetaState, collect: Collect
    ) -> tuple[BonusMetaState, dict[str, Any]]:
        """Do one meta-iteration.

        Returns:
            The new state, and what the learner says of its step with `curiosity` beside it. The
            returns are those of the first and the last agents, or episodes of a trial, without
            bonus.
        """
        learner_key, pay_key, learn_key = jax.random.split(key, 3)
        paying = _CollectWithBonus(self.curiosity, pay_key, state.curiosity, collect)
        learned, info = self.learner.step(learner_key, state.learner, paying)
        told = {field.name: getattr(info, field.name) for field in dataclasses.fields(info)}
        told |= {"return_before": paying.returns[0], "return_after": paying.returns[-1]}
        told["curiosity"] = BonusInfo(paying.bonus, paying.state.medians.moments()[0][0])
        return BonusMetaState(learned, _learn(self.curiosity, learn_key, paying.state)), told


class _CollectWithBonus:
    """`Collect` that adds the bonus to the rewards."""

    def __init__(
        self, curiosity: CuriosityBonus, key: Key, state: CuriosityState, collect: Collect
    ) -> None:
        self.state = state
        self.bonus: Float[Array, ""] = jnp.zeros(())
        self._curiosity = curiosity
        self._key = key
        self._collect = collect
        self._agents: Agents | None = None
        self._batches: list[list[Float[Array, ""]]] = []
        """Mean return of every batch, by who played it."""

    @property
    def returns(self) -> list[Float[Array, ""]]:
        """Mean return, without bonus, of each episode of a trial, or of all batches of an agent."""
        return [jnp.stack(batches).mean() for batches in self._batches]

    @property
    def num_tasks(self) -> int:
        return self._collect.num_tasks

    def __call__(
        self,
        keys: TaskKeys,
        agents: Agents,
        task_index: Int[Array, " task"],
        carry: TrialState | None = None,
    ) -> Episodes:
        episodes = self._collect(keys, agents, task_index, carry)
        key = jax.random.fold_in(self._key, sum(map(len, self._batches)))
        self.state, bonus = _pay(self._curiosity, key, self.state, episodes)
        if agents is not self._agents or carry is not None:
            self._batches.append([])
        self._agents = agents
        self._batches[-1].append(episodes.undiscounted_return.mean())
        self.bonus = bonus.sum(-1).mean()
        return _with_bonus(episodes, bonus)


@eqx.filter_jit
def _pay(
    curiosity: CuriosityBonus, key: Key, state: CuriosityState, episodes: Episodes
) -> tuple[CuriosityState, Float[Array, "task episode time"]]:
    return curiosity.pay(key, state, episodes)


@eqx.filter_jit
def _learn(curiosity: CuriosityBonus, key: Key, state: CuriosityState) -> CuriosityState:
    return curiosity.learn(key, state)


def _with_bonus(episodes: Episodes, bonus: Float[Array, "task episode time"]) -> Episodes:
    """Return the episodes with rewards to learn from; what the policy was shown stays."""
    shown = episodes.reward if episodes.observed_reward is None else episodes.observed_reward
    return dataclasses.replace(episodes, reward=episodes.reward + bonus, observed_reward=shown)


def _split_each(keys: TaskKeys, update: Int[Array, ""]) -> Any:
    """Return two keys per task for one update, `[task, 2]`."""
    folded = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys, update)
    return jax.vmap(jax.random.split)(folded)
