"""A curiosity bonus around any meta-learner."""

import dataclasses
from typing import Any, Generic

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from maesn.axes import ActionKind, Key, TaskKeys
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes
from maesn.learners.base import AbstractFastLearner, AbstractMetaLearner, Info
from maesn.learners.wrappers.bonus import BonusFastLearner, with_bonus
from maesn.learners.wrappers.curiosity import CuriosityBonus, CuriosityState
from maesn.numerics import mesh
from maesn.numerics.mesh import over_tasks


class BonusMetaState(eqx.Module):
    """State of a `BonusMetaLearner`."""

    learner: Any
    curiosity: CuriosityState
    """One model for all tasks, whose dynamics are the same."""


class BonusInfo(eqx.Module):
    """The bonus of one meta-iteration."""

    bonus: Float[Array, ""]
    """Mean bonus of an episode in the last collection."""
    typical_gain: Float[Array, ""]
    """Mean of the last median information gains, in nats for a step of size 1."""


class BonusMetaInfo(eqx.Module, Generic[Info]):
    """What happened in one meta-iteration with a bonus."""

    learner: Info
    """Of the learner's step, but with returns without bonus."""
    curiosity: BonusInfo


class BonusMetaLearner(AbstractMetaLearner[BonusMetaState, BonusMetaInfo[Any]]):
    """A meta-learner with a bonus for what one model of the dynamics learns.

    The bonus of a meta-iteration is that of the model at its beginning; at its end the model
    learns. What it has learned of the dynamics passes on to new tasks.
    """

    learner: AbstractMetaLearner[Any, Any]
    """Learns from reward and bonus."""
    curiosity: CuriosityBonus = CuriosityBonus()
    """What the bonus is."""

    def __check_init__(self) -> None:
        if type(self) in self.learner.slots():
            raise ValueError("`learner` must not have a bonus already: it would be added twice.")

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
        """Return those of the learner; with a bonus it is another method."""
        return (type(self), *self.learner.slots())

    def metrics(self, info: BonusMetaInfo[Any]) -> dict[str, Any]:
        """Return the metrics of the learner by their own names, and those of the bonus."""
        inner = self.learner.metrics(info.learner)
        named = {field.name: getattr(inner, field.name) for field in dataclasses.fields(inner)}
        return named | {"curiosity": info.curiosity}

    def fast_learner(self, state: BonusMetaState) -> AbstractFastLearner[Any]:
        """Return the learner of new tasks; its models begin as the model of the training tasks.

        A learner whose updates do not depend on rewards has no use for a bonus, and comes as it is.
        """
        learner, network = self.learner.fast_learner(state.learner), state.curiosity.network
        if not learner.capabilities.learns_from_reward:
            return learner
        return BonusFastLearner(
            learner=learner,
            curiosity=self.curiosity,
            observation_size=network.output_size,
            action_size=network.input_size - network.output_size,
            trained=state.curiosity,
        )

    def step(
        self, key: Key, state: BonusMetaState, collect: Collect
    ) -> tuple[BonusMetaState, BonusMetaInfo[Any]]:
        """Do one meta-iteration.

        Returns:
            The new state, and what happened. The returns are those of the first and the last stage
            of the meta-iteration, without bonus.
        """
        learner_key, judge_key, learn_key = jax.random.split(key, 3)
        judging = _CollectWithBonus(self.curiosity, judge_key, state.curiosity, collect)
        learned, info = self.learner.step(learner_key, state.learner, judging)
        before, after = judging.first_and_last_return()
        info = dataclasses.replace(info, return_before=before, return_after=after)
        said = BonusInfo(judging.bonus, judging.state.medians.moments()[0][0])
        model = _learn(self.curiosity, learn_key, judging.state)
        return BonusMetaState(learned, model), BonusMetaInfo(info, said)


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
        self._returns: list[tuple[int, Float[Array, ""]]] = []
        """Stage and mean return, without bonus, of every batch."""

    @property
    def num_tasks(self) -> int:
        return self._collect.num_tasks

    @property
    def episodes_per_task(self) -> int:
        return self._collect.episodes_per_task

    def first_and_last_return(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Return the mean returns of the first and of the last stage, over their batches."""
        stages = [stage for stage, _ in self._returns]
        first, last = (
            jnp.stack([mean for stage, mean in self._returns if stage == chosen]).mean()
            for chosen in (min(stages), max(stages))
        )
        return first, last

    def __call__(
        self, keys: TaskKeys, agents: Agents, task_index: Int[Array, " task"], stage: int = 0
    ) -> Episodes:
        episodes = self._collect(keys, agents, task_index, stage)
        key = jax.random.fold_in(self._key, len(self._returns))
        self.state, bonus = over_tasks(_judge, (self._curiosity, key, self.state), episodes)
        sums = episodes.undiscounted_return, bonus.sum(-1)
        (mean_return, self.bonus), _ = over_tasks(_means, None, sums)
        self._returns.append((stage, mean_return))
        return with_bonus(episodes, bonus)


def _judge(
    shared: tuple[CuriosityBonus, Key, CuriosityState], episodes: Episodes
) -> tuple[CuriosityState, Float[Array, "task episode time"]]:
    curiosity, key, state = shared
    return curiosity.judge(key, state, episodes)


def _means(_: None, rows: Any) -> tuple[Any, None]:
    return mesh.mean(jax.tree.map(jnp.mean, rows)), None


@eqx.filter_jit
def _learn(curiosity: CuriosityBonus, key: Key, state: CuriosityState) -> CuriosityState:
    return curiosity.learn(key, state)
