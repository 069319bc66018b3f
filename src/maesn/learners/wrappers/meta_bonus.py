"""A curiosity bonus for any meta-learner: it learns from the sum of reward and bonus."""

import dataclasses
from typing import Any, Generic

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from maesn.axes import ActionKind, Key, TaskKeys
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes
from maesn.learners.base import AbstractFastLearner, AbstractMetaLearner, Info, Problem
from maesn.learners.wrappers.bonus import BonusFastLearner, with_bonus
from maesn.learners.wrappers.curiosity import CuriosityBonus, CuriosityState
from maesn.numerics import mesh
from maesn.numerics.mesh import over_tasks


class BonusMetaState(eqx.Module):
    """State of a `BonusMetaLearner`."""

    learner: Any
    curiosity: CuriosityState
    """One model for all tasks: their dynamics are the same."""


class BonusInfo(eqx.Module):
    """The bonus of one meta-iteration."""

    bonus: Float[Array, ""]
    """Mean bonus of an episode in the last collection."""
    typical_gain: Float[Array, ""]
    """`CuriosityState.typical_gain`, in nats for a step of size 1."""


class BonusMetaInfo(eqx.Module, Generic[Info]):
    """Info of one meta-iteration with a bonus."""

    learner: Info
    """The learner's own info, with the returns without bonus."""
    curiosity: BonusInfo


class BonusMetaLearner(AbstractMetaLearner[BonusMetaState, BonusMetaInfo[Any]]):
    """A meta-learner with a curiosity bonus, from one model of the dynamics for all tasks.

    The model is trained at the end of each meta-iteration, and stays the same during it.
    New tasks start from the trained model.
    """

    learner: AbstractMetaLearner[Any, Any]
    """The meta-learner that gets the bonus."""
    curiosity: CuriosityBonus = CuriosityBonus()
    """Settings of the bonus."""

    def __check_init__(self) -> None:
        if type(self) in self.learner.slots():
            raise ValueError("`learner` must not have a bonus already: it would be added twice.")

    def init(self, key: Key, problem: Problem) -> BonusMetaState:
        learner_key, model_key = jax.random.split(key)
        return BonusMetaState(
            self.learner.init(learner_key, problem),
            self.curiosity.init(model_key, problem.observation_size, problem.action_size),
        )

    def iteration(self, state: BonusMetaState) -> Int[Array, ""]:
        return self.learner.iteration(state.learner)

    def weights(self, state: BonusMetaState) -> Any:
        return self.learner.weights(state.learner), state.curiosity

    def planned_episodes(self, episodes_per_task: int, iterations: int) -> int:
        return self.learner.planned_episodes(episodes_per_task, iterations)

    def for_actions(self, kind: ActionKind) -> "BonusMetaLearner":
        return dataclasses.replace(self, learner=self.learner.for_actions(kind))

    def check_batch(self, episodes_per_task: int) -> None:
        self.learner.check_batch(episodes_per_task)

    def slots(self) -> tuple[Any, ...]:
        """Return the learner's slots after this class: with a bonus it is another method."""
        return (type(self), *self.learner.slots())

    def metrics(self, info: BonusMetaInfo[Any]) -> dict[str, Any]:
        """Return the metrics of the learner by their own names, and those of the bonus."""
        inner = self.learner.metrics(info.learner)
        named = {field.name: getattr(inner, field.name) for field in dataclasses.fields(inner)}
        return named | {"curiosity": info.curiosity}

    def fast_learner(self, state: BonusMetaState) -> AbstractFastLearner[Any]:
        """Return the learner of new tasks, whose models start from the trained one.

        A learner whose updates do not depend on rewards is returned without a bonus.
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
            The new state and the info. Its returns are those of the first and the last stage of
            the meta-iteration, without bonus.
        """
        learner_key, judge_key, learn_key = jax.random.split(key, 3)
        collector = _CollectWithBonus(self.curiosity, judge_key, state.curiosity, collect)
        learned, info = self.learner.step(learner_key, state.learner, collector)
        before, after = collector.first_and_last_return()
        info = dataclasses.replace(info, return_before=before, return_after=after)
        bonus_info = BonusInfo(collector.bonus, collector.state.typical_gain)
        model = _learn(self.curiosity, learn_key, collector.state)
        return BonusMetaState(learned, model), BonusMetaInfo(info, bonus_info)


class _CollectWithBonus:
    """`Collect` that adds the bonus to the rewards, for the collections of one meta-iteration.

    `state` changes with each collection; `bonus` is the mean bonus of an episode in the last one.
    """

    def __init__(
        self, curiosity: CuriosityBonus, key: Key, state: CuriosityState, collect: Collect
    ) -> None:
        self.state = state
        self.bonus: Float[Array, ""] = jnp.zeros(())
        self._curiosity = curiosity
        self._key = key
        self._collect = collect
        self._returns: list[tuple[int, Float[Array, ""]]] = []
        """Stage and mean return of each collection, without bonus."""

    @property
    def num_tasks(self) -> int:
        return self._collect.num_tasks

    @property
    def episodes_per_task(self) -> int:
        return self._collect.episodes_per_task

    def first_and_last_return(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Return the mean returns of the first and the last stage, over their collections."""
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
        per_episode = episodes.undiscounted_return, bonus.sum(-1)
        (mean_return, self.bonus), _ = over_tasks(_means, None, per_episode)
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
