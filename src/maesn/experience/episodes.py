"""Batches of episodes, and the function that plays them: all that learning sees of the world."""

from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import Key, TaskKeys
from maesn.experience.agent import Agents
from maesn.experience.trial_state import TrialState
from maesn.numerics import AbstractDistribution
from maesn.policies import PolicyInput


class Thinning(NamedTuple):
    """Every `stride`-th time step of an episode, from the one at `offset` on: `Episodes.every`."""

    stride: int
    offset: int | Int[Array, ""]

    @staticmethod
    def draw(key: Key, stride: int, time: int) -> "Thinning":
        """Return a thinning of `time` steps, with which every step can be drawn."""
        stride = min(stride, time)
        # Also where the stride does not divide the horizon.
        return Thinning(stride, jax.random.randint(key, (), 0, stride + time % stride))


class Episodes(eqx.Module):
    """Episodes of fixed length, masked by `valid`.

    The leading axes `*batch` are `task episode` in a collected batch and `episode` for one task.
    What happens after an episode has ended is garbage and must change nothing.
    """

    observation: Float[Array, "*batch time_plus_1 observation"]
    """o_0 ... o_T. The last one is needed for bootstrapping and for models of the dynamics.

    The state that terminates an episode need not be finite: whoever reads o_{t+1} must mask it."""
    action: Float[Array, "*batch time action"]
    """The policy's own actions, before the environment clips or scales them."""
    reward: Float[Array, "*batch time"]
    """r_t, for the step from o_t to o_{t+1}."""
    goal_reward: Float[Array, "*batch time"]
    """The part of `reward` that is due to the goal: without control and survival terms."""
    valid: Bool[Array, "*batch time"]
    """True while the episode has not terminated before step t."""
    solved: Bool[Array, "*batch time"]
    """Whether the state after step t lies in the goal region."""
    solved_at_start: Bool[Array, "*batch"]
    """Whether the episode starts in the goal region, which is no success of the policy."""
    terminated: Bool[Array, "*batch"]
    """Whether the episode ended by the task's own rules rather than by the clock."""
    noise: Float[Array, "*batch noise"]
    """The standard normal draw behind z; no components for a z that is not random."""
    description: Float[Array, "*batch description"]
    """What tells the task from all others, if z is made of it; else no components."""
    z: Float[Array, "*batch z"]
    """What the context fed to the policy throughout the episode."""
    behaviour: AbstractDistribution
    """The distribution that each action was drawn from, `[*batch time action]`."""
    trial_end: TrialState | None
    """After the last step: where the next episode of the trial goes on."""
    trial_start: TrialState | None = None
    """Before the first step; None where a trial of a policy that is not recurrent begins."""
    observed_reward: Float[Array, "*batch time"] | None = None
    """r_t as the policy received it; None if that is `reward`."""

    def policy_inputs(self) -> PolicyInput:
        """Return the policy's inputs at every step, `[*batch time ...]`; 0 where invalid."""
        steps = self.action.shape[-2]
        rewards = self.reward if self.observed_reward is None else self.observed_reward
        first_action, first_reward = (
            jnp.zeros_like(self.action[..., 0, :]),
            jnp.zeros_like(rewards[..., 0]),
        )
        if self.trial_start is not None:
            first_action, first_reward = self.trial_start.action, self.trial_start.reward
        previous_action = jnp.concatenate(
            [first_action[..., None, :], self.action[..., :-1, :]], axis=-2
        )
        previous_reward = jnp.concatenate([first_reward[..., None], rewards[..., :-1]], axis=-1)
        # Zeros instead of garbage, since the gradient of a masked NaN is NaN.
        return PolicyInput(
            observation=jnp.where(self.valid[..., None], self.observation[..., :steps, :], 0.0),
            previous_action=jnp.where(self.valid[..., None], previous_action, 0.0),
            previous_reward=jnp.where(self.valid, previous_reward, 0.0),
            episode_start=self.valid.at[..., 1:].set(False),
        )

    @property
    def undiscounted_return(self) -> Float[Array, "*batch"]:
        """sum_t r_t over the valid steps."""
        return jnp.where(self.valid, self.reward, 0.0).sum(-1)

    def every(self, stride: int, offset: int | Array) -> "Episodes":
        """Return every `stride`-th step, starting at step `offset` in [0, stride + time % stride).

        Neighbouring steps of an episode resemble each other, so an average over the thinned steps
        is nearly as good as one over all. What needs whole episodes (returns) must be computed
        before, and a recurrent policy needs all steps, a stride of 1. `observation` keeps no
        final state: it has as many steps as `action`.
        """
        time = self.action.shape[-2]
        stride = min(stride, time)
        steps = time // stride
        first = jnp.asarray(offset)

        def thin(x: Array, axis: int) -> Array:
            indices = first + stride * jnp.arange(steps)
            return jnp.take(x, indices, axis=axis)

        batch_rank = self.terminated.ndim
        return Episodes(
            observation=thin(self.observation, batch_rank),
            action=thin(self.action, batch_rank),
            reward=thin(self.reward, batch_rank),
            goal_reward=thin(self.goal_reward, batch_rank),
            valid=thin(self.valid, batch_rank),
            solved=thin(self.solved, batch_rank),
            solved_at_start=self.solved_at_start,
            terminated=self.terminated,
            noise=self.noise,
            description=self.description,
            z=self.z,
            behaviour=jax.tree.map(lambda x: thin(x, batch_rank), self.behaviour),
            trial_end=None,
            trial_start=self.trial_start if stride == 1 else None,
            observed_reward=jax.tree.map(lambda x: thin(x, batch_rank), self.observed_reward),
        )


def concatenate(first: Episodes, second: Episodes) -> Episodes:
    """Join two batches of the same tasks along the `episode` axis."""
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b], axis=1), first, second)


@runtime_checkable
class Collect(Protocol):
    """Plays episodes; all that a learner sees of the world."""

    @property
    def num_tasks(self) -> int:
        """Number of tasks that can be played."""

    @property
    def episodes_per_task(self) -> int:
        """Number of episodes of each task that one call plays."""

    def __call__(
        self, keys: TaskKeys, agents: Agents, task_index: Int[Array, " task"], stage: int = 0
    ) -> Episodes:
        """Play `episodes_per_task` episodes of each task.

        Args:
            keys: one key per task slot. All randomness of slot i comes from `keys[i]`, so what is
                played in it depends neither on the other slots nor on how many there are.
            agents: one agent per task slot. Their trials go on from `agents.trial_state`.
            task_index: which task each slot plays.
            stage: number of inner updates, or of episodes of the trial, that lie before these
                episodes. It changes nothing about them; wrappers tell batches apart by it.

        Returns:
            Episodes with the leading axes `task episode`.
        """
