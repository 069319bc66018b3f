"""A meta-learner around another one: it learns from the sum of reward and curiosity bonus.

    export PYTHONPATH=examples
    maesn train meta_curiosity:WithCuriosity --family wheeled --reward sparse --run runs/curiosity
    maesn adapt runs/curiosity --method meta_curiosity:WithCuriosity

The bonus is that of VIME (docs/explanation/methods/vime.md). One model of the dynamics serves all
tasks: their dynamics are the same. It is trained at the end of each meta-iteration and stays the
same during it, and new tasks start from it. `rl2_with_curiosity` is the same around RL2; name
others likewise.
"""

from dataclasses import fields, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

import maesn


class WithCuriosityState(eqx.Module):
    """What changes in training."""

    learner: Any
    curiosity: Any
    """The model of the dynamics."""


class BonusInfo(eqx.Module):
    """The bonus of one meta-iteration."""

    bonus: Float[Array, ""]
    """Mean bonus of an episode in the last collection."""
    typical_gain: Float[Array, ""]
    """Information gain, in nats, of a transition whose bonus is the weight."""


class WithCuriosityInfo(eqx.Module):
    """What a meta-iteration tells a person."""

    learner: Any
    """The learner's own info, with the returns without bonus."""
    curiosity: BonusInfo


class WithCuriosity(maesn.AbstractMetaLearner[WithCuriosityState, WithCuriosityInfo]):
    """A meta-learner with a curiosity bonus."""

    learner: maesn.AbstractMetaLearner = maesn.maesn()
    """The meta-learner that gets the bonus."""
    curiosity: maesn.CuriosityBonus = maesn.CuriosityBonus()
    """Settings of the bonus."""

    def init(self, key: Array, problem: maesn.Problem) -> WithCuriosityState:
        learner_key, model_key = jax.random.split(key)
        sizes = problem.observation_size, problem.action_size
        return WithCuriosityState(
            self.learner.init(learner_key, problem), self.curiosity.init(model_key, *sizes)
        )

    def step(
        self, key: Array, state: WithCuriosityState, collect: maesn.Collect
    ) -> tuple[WithCuriosityState, WithCuriosityInfo]:
        learner_key, judge_key, learn_key = jax.random.split(key, 3)
        collecting = CollectWithBonus(self.curiosity, judge_key, state.curiosity, collect)
        learned, info = self.learner.step(learner_key, state.learner, collecting)
        before, after = collecting.mean_return(min), collecting.mean_return(max)
        info = replace(info, return_before=before, return_after=after)
        told = WithCuriosityInfo(info, BonusInfo(collecting.bonus, collecting.state.typical_gain))
        model = eqx.filter_jit(self.curiosity.learn)(learn_key, collecting.state)
        return WithCuriosityState(learned, model), told

    def fast_learner(self, state: WithCuriosityState) -> maesn.AbstractFastLearner:
        """Return the learner of new tasks; without a bonus, if its updates read no rewards."""
        learner, network = self.learner.fast_learner(state.learner), state.curiosity.network
        if not learner.capabilities.learns_from_reward:
            return learner
        return maesn.BonusFastLearner(
            learner=learner,
            curiosity=self.curiosity,
            observation_size=network.output_size,
            action_size=network.input_size - network.output_size,
            trained=state.curiosity,
        )

    def iteration(self, state: WithCuriosityState) -> Int[Array, ""]:
        return self.learner.iteration(state.learner)

    def weights(self, state: WithCuriosityState) -> Any:
        return self.learner.weights(state.learner), state.curiosity

    def replay(self, state: WithCuriosityState) -> Any:
        return self.learner.replay(state.learner)

    def planned_episodes(self, episodes_per_task: int, iterations: int) -> int:
        return self.learner.planned_episodes(episodes_per_task, iterations)

    def for_actions(self, kind: str) -> "WithCuriosity":
        return replace(self, learner=self.learner.for_actions(kind))

    def check_batch(self, episodes_per_task: int) -> None:
        self.learner.check_batch(episodes_per_task)

    def metrics(self, info: WithCuriosityInfo) -> dict[str, Any]:
        """Return the metrics of the learner by their own names, and those of the bonus."""
        inner = self.learner.metrics(info.learner)
        named = {field.name: getattr(inner, field.name) for field in fields(inner)}
        return named | {"curiosity": info.curiosity}


class CollectWithBonus:
    """`maesn.Collect` that adds the bonus to the rewards, for one meta-iteration.

    Attributes:
        state: the model of the dynamics; each collection adds transitions to its pool.
        bonus: mean bonus of an episode in the last collection.
    """

    def __init__(
        self, curiosity: maesn.CuriosityBonus, key: Array, state: Any, collect: maesn.Collect
    ) -> None:
        self.state, self.bonus = state, jnp.zeros(())
        self._judge = eqx.filter_jit(curiosity.judge)
        self._key, self._collect = key, collect
        self._returns: list[tuple[int, Float[Array, ""]]] = []  # stage, mean without bonus

    @property
    def num_tasks(self) -> int:
        return self._collect.num_tasks

    @property
    def episodes_per_task(self) -> int:
        return self._collect.episodes_per_task

    def mean_return(self, choose: Any) -> Float[Array, ""]:
        """Return the mean return without bonus of one stage: `choose` of all stages."""
        chosen = choose(stage for stage, _ in self._returns)
        return jnp.stack([mean for stage, mean in self._returns if stage == chosen]).mean()

    def __call__(
        self, keys: Array, agents: maesn.Agents, task_index: Int[Array, " task"], stage: int = 0
    ) -> maesn.Episodes:
        episodes = self._collect(keys, agents, task_index, stage)
        key = jax.random.fold_in(self._key, len(self._returns))
        self.state, bonus = self._judge(key, self.state, episodes)
        self.bonus = bonus.sum(-1).mean()
        self._returns.append((stage, episodes.undiscounted_return.mean()))
        # The policy is shown the reward that it played for, without the bonus.
        shown = episodes.received_reward
        return replace(episodes, reward=episodes.reward + bonus, observed_reward=shown)


rl2_with_curiosity = WithCuriosity(maesn.rl2())
