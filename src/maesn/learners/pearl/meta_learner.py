"""PEARL: probabilistic embeddings for actor-critic RL (Rakelly et al. 2019).

https://arxiv.org/abs/1903.08254. Off-policy: a meta-iteration visits a few tasks, keeps what it has
seen there, and takes many gradient steps on transitions of all tasks so far.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import Key, ObservedReward
from maesn.context import Latent
from maesn.experience.agent import Agents
from maesn.experience.episodes import Collect, Episodes
from maesn.learners.meta import AbstractMetaLearner, Problem
from maesn.learners.meta_batch import check_enough_tasks, draw_tasks, task_keys
from maesn.learners.pearl.encoder import ContextEncoder, EncoderSettings
from maesn.learners.pearl.fast_learner import PearlFastLearner
from maesn.learners.pearl.replay import Replay
from maesn.learners.pearl.sac import ActorCritic, Optimisers, SoftActorCritic, SoftLosses
from maesn.numerics import DiagonalGaussian, if_finite
from maesn.numerics.mesh import refuse_sharing
from maesn.settings import check_choice, check_least

# Bytes that the replay of all tasks takes at most, in a file beside the newest checkpoint.
MOST_REPLAY_BYTES = 150_000_000


class Networks(eqx.Module):
    """What is trained by gradients, and the scale of z that results."""

    encoder: ContextEncoder
    actor_critic: ActorCritic
    latent_scale: Float[Array, ""]
    """Root mean square of the components of z in the last gradient steps."""

    def agents(self, belief: Latent) -> Agents:
        """Return agents with noise in their actions, which draw z from a belief on each task."""
        return Agents(self.actor_critic.policy, belief, shares_policy=True)


class PearlState(eqx.Module):
    """State of a `PearlMetaLearner`."""

    networks: Networks
    optimisers: Optimisers
    replay: Replay
    iteration: Int[Array, ""]


class PearlInfo(eqx.Module):
    """Info of one meta-iteration: scalars only."""

    return_before: Float[Array, ""]
    """Mean undiscounted return of the episodes with z from the prior."""
    return_after: Float[Array, ""]
    """Mean undiscounted return of the last episodes, with z from the posterior if any are."""
    success_after: Float[Array, ""]
    """Share of the last episodes that reach the goal region."""
    kl: Float[Array, ""]
    """Mean divergence of the posterior of a task from the prior, in nats."""
    latent_std: Float[Array, ""]
    """Mean standard deviation of the posteriors."""
    losses: SoftLosses
    """Means over the gradient steps."""
    accepted: Bool[Array, ""]
    """False if the gradient steps led to numbers that are not finite: all networks stay."""


class PearlMetaLearner(AbstractMetaLearner[PearlState, PearlInfo]):
    """Infers the task from transitions, and learns off-policy to act on what it infers."""

    encoder: EncoderSettings = EncoderSettings()
    """The posterior over z."""
    sac: SoftActorCritic = SoftActorCritic()
    """Soft actor-critic."""
    context_reward: ObservedReward = "own"
    """Reward that the context shows: the world's own, or the sparse one while the critics learn
    from the dense one. Reference: own; sparse on sparse point goals."""
    meta_batch_size: int = 16
    """Tasks in a gradient step, drawn with replacement. Reference: 16."""
    gradient_steps: int = 2000
    """Gradient steps of a meta-iteration. Reference: 2000; 1000 on point goals."""
    visited_tasks: int = 5
    """Training tasks that a meta-iteration plays. Reference: 5; 10 on point goals."""
    initial_tasks: int = 20
    """Training tasks that the first meta-iteration plays beforehand, one batch of episodes each.
    (Reference: all of them.)"""
    prior_batches: int = 1
    """Batches of `episodes_per_task` episodes of a visit, with z from the prior."""
    posterior_batches: int = 0
    """Batches after them, with z from the posterior, that are part of the context. Reference: none;
    45 single episodes on sparse point goals."""
    extra_batches: int = 1
    """Batches after these, with z from the posterior, that the critics alone learn from."""
    prior_episodes: int = 1
    """Episodes of a new task whose z is drawn from the prior. Reference: 1; 5 on sparse point
    goals."""
    noisy_exploration: bool = False
    """Whether actions have the noise of training where a new task is explored. Reference: no, which
    makes contexts unlike those that the encoder has learned from."""
    replay_steps: int = 20_000
    """Transitions that are kept of each task; fewer if those of all tasks would take more than
    150 MB. Reference: 1e6."""

    def __check_init__(self) -> None:
        check_least(
            self,
            meta_batch_size=1,
            gradient_steps=1,
            visited_tasks=1,
            prior_batches=1,
            replay_steps=1,
        )
        check_least(self, initial_tasks=0, posterior_batches=0, extra_batches=0, prior_episodes=0)
        check_choice("context_reward", self.context_reward, ObservedReward)

    @property
    def batches(self) -> int:
        """Batches of episodes of a visit."""
        return self.prior_batches + self.posterior_batches + self.extra_batches

    def init(self, key: Key, problem: Problem) -> PearlState:
        if problem.action_kind != "continuous":
            raise ValueError("PEARL learns by a soft actor-critic for continuous actions only.")
        for name in ("visited_tasks", "initial_tasks"):
            check_enough_tasks(problem.num_tasks, getattr(self, name), name)
        sizes = problem.observation_size, problem.action_size
        encoder_key, actor_key = jax.random.split(key)
        encoder = self.encoder.init(encoder_key, *sizes)
        actor_critic = self.sac.init(
            actor_key, *sizes, self.encoder.latent_size, self.context_reward
        )
        return PearlState(
            Networks(encoder, actor_critic, jnp.ones(())),
            self.sac.init_optimisers(actor_critic, encoder),
            Replay.empty(problem.num_tasks, self._capacity(problem), *sizes),
            jnp.zeros((), int),
        )

    def _capacity(self, problem: Problem) -> int:
        # Numbers of a transition: the fields of `Batch`.
        features = 2 * problem.observation_size + problem.action_size + 3
        most = MOST_REPLAY_BYTES // (4 * features * problem.num_tasks)
        capacity = min(self.replay_steps, most)
        visit = self.batches * problem.episodes_per_task * problem.horizon
        if capacity < visit:
            raise ValueError(
                f"a visit to a task takes up to {visit} steps, but the replay holds only "
                f"{capacity} of each task: play fewer episodes, or raise `replay_steps` if it is "
                f"below {most}."
            )
        return capacity

    def weights(self, state: PearlState) -> Networks:
        """Return all networks: a policy without its critics could not go on learning."""
        return state.networks

    def replay(self, state: PearlState) -> tuple[Optimisers, Replay]:
        """Return Adam's moments as well, which take twice as much as the networks."""
        return state.optimisers, state.replay

    def planned_episodes(self, episodes_per_task: int, iterations: int) -> int:
        first = self.initial_tasks if iterations else 0
        return (first + iterations * self.batches * self.visited_tasks) * episodes_per_task

    def effort(self, steps: int, iterations: int) -> int:
        # A gradient step takes 7 ms, in which others train on so many steps.
        return steps + 350 * self.gradient_steps * iterations

    def check_batch(self, episodes_per_task: int) -> None:
        """One device learns, because one holds the replay."""
        refuse_sharing()

    def fast_learner(self, state: PearlState) -> PearlFastLearner:
        networks = state.networks
        return PearlFastLearner(
            networks.actor_critic.policy,
            networks.encoder,
            networks.latent_scale,
            self.prior_episodes,
            self.encoder.next_observation,
            self.noisy_exploration,
        )

    def step(self, key: Key, state: PearlState, collect: Collect) -> tuple[PearlState, PearlInfo]:
        begin_key, visit_key, learn_key = jax.random.split(key, 3)
        replay = state.replay
        if int(state.iteration) == 0:
            replay = self._begin(begin_key, state.networks, replay, collect)
        replay, played = self._visit(visit_key, state.networks, replay, collect)
        networks, optimisers, (kl, latent_std, losses), accepted = self._learn(
            learn_key, state.networks, state.optimisers, replay
        )
        last = played[-1]
        info = PearlInfo(
            return_before=played[0].undiscounted_return.mean(),
            return_after=last.undiscounted_return.mean(),
            success_after=last.success.mean(),
            kl=kl,
            latent_std=latent_std,
            losses=losses,
            accepted=accepted,
        )
        return PearlState(networks, optimisers, replay, state.iteration + 1), info

    def _begin(self, key: Key, networks: Networks, replay: Replay, collect: Collect) -> Replay:
        """Play `initial_tasks` tasks with z from the prior, as many at once as in a visit."""
        task_key, play_key = jax.random.split(key)
        tasks = draw_tasks(task_key, collect.num_tasks, self.initial_tasks)
        for number, first in enumerate(range(0, self.initial_tasks, self.visited_tasks)):
            some = tasks[first : first + self.visited_tasks]
            agents = networks.agents(networks.encoder.none(len(some)).posterior())
            episodes = collect(task_keys(play_key, number, len(some)), agents, some)
            replay = replay.add(some, episodes, begins=True, is_context=True)
        return replay

    def _visit(
        self, key: Key, networks: Networks, replay: Replay, collect: Collect
    ) -> tuple[Replay, list[Episodes]]:
        task_key, play_key, context_key = jax.random.split(key, 3)
        tasks = draw_tasks(task_key, collect.num_tasks, self.visited_tasks)
        played: list[Episodes] = []
        for number in range(self.batches):
            if number < self.prior_batches:
                belief = networks.encoder.none(len(tasks)).posterior()
            else:
                drawn = jax.random.fold_in(context_key, number)
                belief = self._posterior(networks.encoder, replay, tasks, drawn)
            keys = task_keys(play_key, number, self.visited_tasks)
            played.append(collect(keys, networks.agents(belief), tasks, stage=number))
            is_context = number < self.prior_batches + self.posterior_batches
            replay = replay.add(tasks, played[-1], begins=number == 0, is_context=is_context)
        return replay, played

    @eqx.filter_jit
    def _posterior(
        self, encoder: ContextEncoder, replay: Replay, tasks: Int[Array, " task"], key: Key
    ) -> Latent:
        drawn = replay.sample_context(key, tasks, self.encoder.context_size)
        context = drawn.context(self.encoder.next_observation)
        return jax.vmap(encoder)(context, jnp.ones(context.shape[:2], bool)).posterior()

    @eqx.filter_jit
    def _learn(
        self, key: Key, networks: Networks, optimisers: Optimisers, replay: Replay
    ) -> tuple[Networks, Optimisers, Any, Bool[Array, ""]]:
        """Take the gradient steps; returns averages of divergence, spread and losses."""

        def one(now: Any, step_key: Key) -> Any:
            networks, optimisers, described = self._gradient_step(step_key, now[0], now[1], replay)
            return (networks, optimisers), described

        before = networks, optimisers
        after, described = jax.lax.scan(one, before, jax.random.split(key, self.gradient_steps))
        (networks, optimisers), accepted = if_finite(after, before)
        return networks, optimisers, jax.tree.map(lambda x: x.mean(0), described), accepted

    def _gradient_step(
        self, key: Key, networks: Networks, optimisers: Optimisers, replay: Replay
    ) -> tuple[Networks, Optimisers, Any]:
        task_key, batch_key, context_key, z_key, action_key = jax.random.split(key, 5)
        chances = jnp.where(replay.is_played, 0.0, -jnp.inf)
        tasks = jax.random.categorical(task_key, chances, shape=(self.meta_batch_size,))
        size = self.sac.batch_size
        batch = replay.sample(batch_key, tasks, size)
        batch = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batch)
        noise = jax.random.normal(z_key, (self.meta_batch_size, self.encoder.latent_size))

        def infer(encoder: ContextEncoder) -> tuple[Array, Array]:
            posterior = self._posterior(encoder, replay, tasks, context_key)
            z = posterior.distribution.sample_from_noise(noise)
            return jnp.repeat(z, size, axis=0), self.encoder.kl_weight * divergence(posterior).sum()

        actor_critic, encoder, optimisers, losses = self.sac.step(
            action_key, networks.actor_critic, networks.encoder, optimisers, batch, infer
        )
        posterior = self._posterior(networks.encoder, replay, tasks, context_key)
        std, square = jnp.exp(posterior.log_std), posterior.mean**2
        # The scale of about the last hundred steps.
        scale = jnp.sqrt(0.99 * networks.latent_scale**2 + 0.01 * (square + std**2).mean())
        described = divergence(posterior).mean(), std.mean(), losses
        return Networks(encoder, actor_critic, scale), optimisers, described


def divergence(posterior: Latent) -> Float[Array, "*batch"]:
    """Return KL(q(z) || N(0, I)) of every task, in nats."""
    return posterior.distribution.kl(DiagonalGaussian.standard(posterior.mean.shape))
