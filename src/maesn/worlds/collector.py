"""Play episodes in any world: the function `collect` that learners are given."""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from maesn.axes import HostReadings, Key, Readings, RecurrentState, TaskKeys
from maesn.envs.base import AnyEnv
from maesn.experience.agent import Agent, Agents, TrialState
from maesn.experience.episodes import Episodes
from maesn.policies import PolicyInput
from maesn.worlds import (
    AbstractWorld,
    Actors,
    Decision,
    EpisodeError,
    Moment,
    SimulationFailure,
    Trajectory,
)
from maesn.worlds.budget import check_memory
from maesn.worlds.contract import check_policy
from maesn.worlds.outcome import ends, judge, observe


@lru_cache(maxsize=64)
def _programs(env: AnyEnv, episodes_per_task: int) -> tuple[Any, Any, Any]:
    """Return what runs before, in, and after the steps of a world, compiled once for equal ones."""
    batch = _Batch(env, episodes_per_task)
    return jax.jit(batch.begin), jax.jit(batch.decide), jax.jit(batch.assemble)


class Collector:
    """`maesn.experience.episodes.Collect` on a world.

    Args:
        world: the world to play in.
        episodes_per_task: number of episodes of each task that one call plays.
        watch: called after each call with the episodes and readings, as `play` returns them, and
            with `stage`.
    """

    def __init__(
        self,
        world: AbstractWorld,
        episodes_per_task: int,
        watch: Callable[[Episodes, Readings | HostReadings, int], None] | None = None,
    ) -> None:
        self.world = world
        self.episodes_per_task = episodes_per_task
        self._watch = watch
        self._begin, self._decide, self._assemble = _programs(world.env, episodes_per_task)

    @property
    def num_tasks(self) -> int:
        """Number of tasks of the world."""
        return len(self.world.tasks)

    @property
    def most_tasks(self) -> int:
        """Largest number of tasks that one call can play."""
        most = self.world.max_simulations
        return sys.maxsize if most is None else max(most // self.episodes_per_task, 1)

    def parts(self, count: int) -> list[slice]:
        """Return slices of `count` tasks, each of as many as one call can play."""
        size = max(1, min(self.most_tasks, count))
        return [slice(first, first + size) for first in range(0, count, size)]

    def __call__(
        self, keys: TaskKeys, agents: Agents, task_index: Int[Array, " task"], stage: int = 0
    ) -> Episodes:
        """See `Collect`.

        Raises:
            EpisodeError: a state, an action or a reward is not finite.
            RunError: the machine cannot hold that many episodes at once, or the policy's actions
                are of another kind than the environment's.
        """
        episodes, readings = self.play(keys, agents, task_index)
        if self._watch is not None:
            self._watch(episodes, readings, stage)
        return episodes

    def play(
        self, keys: TaskKeys, agents: Agents, task_index: Int[Array, " task"]
    ) -> tuple[Episodes, Readings | HostReadings]:
        """Play as a call does; return all readings as well, `[time_plus_1, simulation, ...]`."""
        check_policy(agents.policy, self.world.env)
        check_memory(self.world.env, len(task_index) * self.episodes_per_task)
        tasks = self.world.tasks[np.asarray(task_index)]
        # The trial state is added afterwards, so that the first and the later episodes of trials
        # share one compiled program.
        actors, start = self._begin(keys, replace(agents, trial_state=None), tasks)
        if agents.trial_state is not None:
            actors = replace(actors, trial_state=agents.trial_state)
        try:
            trajectory = self.world.play(self._decide, actors, start)
        except SimulationFailure as failure:
            task_slot, episode = divmod(failure.simulation, self.episodes_per_task)
            task = int(task_index[task_slot])
            raise EpisodeError(
                self.world.env.name, task, episode, failure.step, failure.reason
            ) from failure
        episodes, finite = self._assemble(actors, trajectory)
        self._check_finite(finite, np.asarray(task_index))
        return episodes, trajectory.readings

    def _check_finite(self, finite: "_Finite", task_index: np.ndarray) -> None:
        """Raise an error about the earliest step that is not finite, if there is one."""
        failures = [
            (step, task_slot, episode, name)
            for name, mask in finite._asdict().items()
            for task_slot, episode, step in np.argwhere(~np.asarray(mask)).tolist()
        ]
        if failures:
            step, task_slot, episode, name = min(failures, key=lambda failure: failure[0])
            task, reason = int(task_index[task_slot]), f"the {name} is not finite"
            raise EpisodeError(self.world.env.name, task, episode, step, reason)


class _Batch(NamedTuple):
    """The pure functions that play a batch of episodes, with the environment as a constant."""

    env: AnyEnv
    episodes_per_task: int

    def begin(self, keys: TaskKeys, agents: Agents, tasks: Any) -> tuple[Actors, Any]:
        """Draw z, the initial state, and the noise of the actions of every episode."""
        env, episodes = self.env, jnp.arange(self.episodes_per_task)
        distribution = agents.policy.distribution

        def begin_episode(agent: Agent, key: Key, task: Any, episode: Array) -> Any:
            context_key, start_key, action_key = jax.random.split(
                jax.random.fold_in(key, episode), 3
            )
            context = agent.context
            noise = context.noise(context_key, episode)
            # For an oracle alone: the episodes of other learners must not contain their task.
            description = env.describe(task) if context.description_size else jnp.zeros(0)
            action_noise = distribution.noise(action_key, (env.horizon, env.action_size))
            recurrent_state = agent.policy.initial_recurrent_state()
            trial = TrialState(recurrent_state, jnp.zeros(env.action_size), jnp.zeros(()))
            z = context.draw(noise, description)
            return noise, description, z, action_noise, trial, env.start(start_key, task)

        def begin_task(agent: Agent, key: Key, task: Any) -> Any:
            return jax.vmap(begin_episode, in_axes=(None, None, None, 0))(
                agent, key, task, episodes
            )

        noise, description, z, action_noise, trial, start = agents.map(
            begin_task, keys, tasks, how="vmap"
        )
        action_noise = jnp.moveaxis(action_noise, 2, 0)
        actors = Actors(agents, tasks, noise, description, z, action_noise, trial)
        return actors, jax.tree.map(_join_batch_axes, start)

    def decide(self, actors: Actors, moment: Moment) -> Decision:
        """Return the policies' actions at one step of every episode."""
        env = self.env
        shape = actors.z.shape[:2]
        readings, previous = jax.tree.map(  # [simulation, ...] -> [task, episode, ...]
            lambda x: x.reshape(*shape, *x.shape[1:]), (moment.readings, moment.previous_readings)
        )
        start, is_noisy = moment.step == 0, actors.agents.is_noisy

        def decide_one(
            agent: Agent, task: Any, z: Array, noise: Array, trial: TrialState, now: Readings,
            before: Readings, previous_action: Array, state: RecurrentState, ended: Array,
        ) -> Any:  # fmt: skip
            reward = env.observed_reward(
                agent.policy.observed_reward, before, previous_action, now, task
            )
            policy_input = PolicyInput(
                observation=observe(env, now, task),
                previous_action=jnp.where(start, trial.action, previous_action),
                previous_reward=jnp.where(start, trial.reward, reward),
                episode_start=start,
            )
            distribution, after = agent.policy(agent.perceive(policy_input), z, state)
            drawn = distribution.sample_from_noise(noise) if is_noisy else distribution.mode()
            # Observations after the end may be NaN, so they must not enter the recurrent state.
            ended = ended | ends(env, now)
            state = jax.tree.map(lambda old, new: jnp.where(ended, old, new), state, after)
            return env.control(drawn), drawn, distribution, state, ended

        per_task = jax.vmap(decide_one, in_axes=(None, None, 0, 0, 0, 0, 0, 0, 0, 0))
        control, *others = actors.agents.map(
            per_task, actors.tasks, actors.z, actors.action_noise[moment.step], actors.trial_state,
            readings, previous, moment.previous_action, moment.recurrent_state, moment.ended,
            how="vmap",
        )  # fmt: skip
        return Decision(_join_batch_axes(control), *others)

    def assemble(self, actors: Actors, trajectory: Trajectory) -> "tuple[Episodes, _Finite]":
        """Turn readings and actions into episodes, and mark the steps that are finite."""
        shape = actors.z.shape[:2]
        readings = jax.tree.map(
            lambda x: jnp.moveaxis(x.reshape(x.shape[0], *shape, *x.shape[2:]), 0, 2),
            trajectory.readings,
        )
        action, behaviour = jax.tree.map(
            lambda x: jnp.moveaxis(x, 0, 2), (trajectory.action, trajectory.behaviour)
        )
        judge_one = partial(judge, self.env, actors.agents.policy.observed_reward)
        observation, reward, observed_reward, solved, ended, terminated = jax.vmap(
            jax.vmap(judge_one, in_axes=(0, 0, None))
        )(readings, action, actors.tasks)
        valid = jnp.logical_not(ended[..., :-1])
        trial_end = actors.agents.map(
            jax.vmap(_end_of_trial_so_far, in_axes=(None, 0, 0, 0, 0, 0, 0)),
            actors.trial_state, trajectory.recurrent_state, observation, action, observed_reward,
            valid, how="vmap",
        )  # fmt: skip
        episodes = Episodes(
            observation=observation,
            action=action,
            reward=reward.total,
            goal_reward=reward.goal,
            valid=valid,
            solved=jnp.logical_and(solved[..., 1:], valid),
            solved_at_start=solved[..., 0],
            terminated=terminated,
            noise=actors.noise,
            description=actors.description,
            z=actors.z,
            behaviour=behaviour,
            trial_end=trial_end,
            trial_start=actors.trial_state,
            observed_reward=observed_reward,
        )
        finite = _Finite(
            jnp.isfinite(observation[..., :-1, :]).all(-1) | ~valid,
            jnp.isfinite(action).all(-1) | ~valid,
            jnp.isfinite(reward.total) | ~valid,
        )
        return episodes, finite


def _end_of_trial_so_far(
    agent: Agent, start: TrialState, recurrent_state: RecurrentState, observation: Array,
    action: Array, observed_reward: Array, valid: Array,
) -> TrialState:  # fmt: skip
    """Return the state of a trial after one episode, whose invalid steps do not change it."""
    last = jnp.maximum(valid.sum() - 1, 0)
    action = jnp.where(valid.any(), action[last], start.action)
    reward = jnp.where(valid.any(), observed_reward[last], start.reward)
    seen = PolicyInput(observation[valid.sum()], action, reward, jnp.zeros((), bool))
    after = agent.policy.after_episode(agent.perceive(seen), recurrent_state)
    return TrialState(after, action, reward)


class _Finite(NamedTuple):
    """Masks of the steps that are finite or invalid.

    Where several fields fail at one step, the first of them is the cause of the others.
    """

    observation: Bool[Array, "task episode time"]
    action: Bool[Array, "task episode time"]
    reward: Bool[Array, "task episode time"]


def _join_batch_axes(x: Array) -> Array:
    """[task, episode, ...] -> [simulation, ...]."""
    return x.reshape(-1, *x.shape[2:])
