"""Play episodes in any world: makes the function `collect` that learners are given."""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from maesn.axes import (
    ActionKind,
    HostReadings,
    Key,
    Readings,
    RecurrentState,
    TaskKeys,
)
from maesn.experience.agent import Agent, Agents
from maesn.experience.episodes import Episodes
from maesn.experience.trial_state import TrialState
from maesn.numerics import AbstractDistribution, Categorical, DiagonalGaussian
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
from maesn.worlds.outcome import ends, judge, observe, terminates

# What a policy returns for each kind of actions. By its type the noise of the actions is drawn,
# before the policy is called.
_DISTRIBUTIONS: dict[ActionKind, type[AbstractDistribution]] = {
    "continuous": DiagonalGaussian,
    "discrete": Categorical,
}


class Collector:
    """`maesn.experience.episodes.Collect` on a world.

    Args:
        world: to play in.
        episodes_per_task: number of episodes of each task that one call plays.
        watch: is shown what each call has played, its states as `play` returns them, and its
            `stage`.
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
        # Compiled once per collector; the environment is a constant of the programs.
        self._begin = jax.jit(self._begin_batch)
        self._act = jax.jit(self._decide)
        self._finish = jax.jit(self._assemble)

    @property
    def num_tasks(self) -> int:
        """Number of tasks of the world."""
        return len(self.world.tasks)

    @property
    def most_tasks(self) -> int:
        """Number of tasks that one call can play at most."""
        most = self.world.max_simulations
        return sys.maxsize if most is None else max(most // self.episodes_per_task, 1)

    def __call__(
        self, keys: TaskKeys, agents: Agents, task_index: Int[Array, " task"], stage: int = 0
    ) -> Episodes:
        """See `Collect`.

        Raises:
            EpisodeError: physics or reward of an episode became non-finite.
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
        """Play episodes as a call does, and keep the states.

        Returns:
            The episodes, and what was read in every state, `[time_plus_1, simulation, ...]`.
        """
        check_policy(agents.policy, self.world.env)
        check_memory(self.world.env, len(task_index) * self.episodes_per_task)
        tasks = self.world.tasks[np.asarray(task_index)]
        # Without the state of the trials, so that their first episode and the others share one
        # compiled program.
        actors, start = self._begin(keys, replace(agents, trial_state=None), tasks)
        if agents.trial_state is not None:
            actors = replace(actors, trial_state=agents.trial_state)
        try:
            trajectory = self.world.play(self._act, actors, start)
        except SimulationFailure as failure:
            task_slot, episode = divmod(failure.simulation, self.episodes_per_task)
            task = int(task_index[task_slot])
            raise EpisodeError(
                self.world.env.name, task, episode, failure.step, failure.reason
            ) from failure
        episodes, finite = self._finish(actors, trajectory)
        self._refuse(finite, np.asarray(task_index))
        return episodes, trajectory.readings

    def _refuse(self, finite: "_Finite", task_index: np.ndarray) -> None:
        """Raise an error if something is not finite, about the earliest step."""
        found = [
            (step, task_slot, episode, name)
            for name, mask in finite._asdict().items()
            for task_slot, episode, step in np.argwhere(~np.asarray(mask)).tolist()
        ]
        if found:
            step, task_slot, episode, name = min(found, key=lambda one: one[0])
            task, reason = int(task_index[task_slot]), f"the {name} is not finite"
            raise EpisodeError(self.world.env.name, task, episode, step, reason)

    def _begin_batch(self, keys: TaskKeys, agents: Agents, tasks: Any) -> tuple[Actors, Any]:
        """Draw z, the initial state, and the noise of the actions of every episode."""
        env, episodes = self.world.env, jnp.arange(self.episodes_per_task)
        distribution = _DISTRIBUTIONS[env.action_kind]

        def begin_episode(agent: Agent, key: Key, task: Any, episode: Array) -> Any:
            context_key, start_key, action_key = jax.random.split(
                jax.random.fold_in(key, episode), 3
            )
            context = agent.context
            noise = jax.random.normal(context_key, (context.noise_size,))
            # Only where z is made of it: no other learner finds its task in the episodes.
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

    def _decide(self, actors: Actors, moment: Moment) -> Decision:
        """Ask the policies for the step of every episode."""
        env = self.world.env
        shape = actors.z.shape[:2]
        readings, previous = jax.tree.map(
            lambda x: _split_batch_axes(x, shape), (moment.readings, moment.previous_readings)
        )
        start = moment.step == 0

        def decide(
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
            action = distribution.sample_from_noise(noise)
            # Observations after the end may be NaN: they must not enter the recurrent state.
            ended = ended | ends(env, now)
            state = jax.tree.map(lambda old, new: jnp.where(ended, old, new), state, after)
            return env.control(action), action, distribution, state, ended

        per_task = jax.vmap(decide, in_axes=(None, None, 0, 0, 0, 0, 0, 0, 0, 0))
        control, *others = actors.agents.map(
            per_task, actors.tasks, actors.z, actors.action_noise[moment.step], actors.trial_state,
            readings, previous, moment.previous_action, moment.recurrent_state, moment.ended,
            how="vmap",
        )  # fmt: skip
        return Decision(_join_batch_axes(control), *others)

    def _assemble(self, actors: Actors, trajectory: Trajectory) -> "tuple[Episodes, _Finite]":
        """Turn readings and actions into episodes; also say what is finite in which steps."""
        shape = actors.z.shape[:2]
        readings = jax.tree.map(
            lambda x: jnp.moveaxis(x.reshape(x.shape[0], *shape, *x.shape[2:]), 0, 2),
            trajectory.readings,
        )
        action, behaviour = jax.tree.map(
            lambda x: jnp.moveaxis(x, 0, 2), (trajectory.action, trajectory.behaviour)
        )
        received = actors.agents.policy.observed_reward
        judged = jax.vmap(jax.vmap(partial(judge, self.world.env, received), in_axes=(0, 0, None)))(
            readings, action, actors.tasks
        )
        observation, reward, observed, solved, ended = judged
        terminated = jax.vmap(jax.vmap(partial(terminates, self.world.env)))(readings)
        valid = jnp.logical_not(ended[..., :-1])
        after = jax.vmap(jax.vmap(TrialState.after))
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
            trial_end=after(
                actors.trial_state, trajectory.recurrent_state, action, observed, valid
            ),
            trial_start=actors.trial_state,
            observed_reward=observed,
        )
        finite = _Finite(
            jnp.isfinite(observation[..., :-1, :]).all(-1) | ~valid,
            jnp.isfinite(action).all(-1) | ~valid,
            jnp.isfinite(reward.total) | ~valid,
        )
        return episodes, finite


class _Finite(NamedTuple):
    """Which steps are finite, or invalid. Each field depends on those before it."""

    observation: Bool[Array, "task episode time"]
    action: Bool[Array, "task episode time"]
    reward: Bool[Array, "task episode time"]


def _join_batch_axes(x: Array) -> Array:
    """[task, episode, ...] -> [simulation, ...]."""
    return x.reshape(-1, *x.shape[2:])


def _split_batch_axes(x: Array, shape: tuple[int, ...]) -> Array:
    """[simulation, ...] -> [task, episode, ...]."""
    return x.reshape(*shape, *x.shape[1:])
