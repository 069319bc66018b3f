"""A batch of episodes, and the function that plays one: all that learning sees of the world."""

from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import Carry, Key, TaskKeys
from maesn.experience.agent import Agents
from maesn.numerics import AbstractDistribution
from maesn.policies import PolicyInput


class TrialState(eqx.Module):
    """What one episode hands to the next one of the same trial."""

    hidden: Carry
    """The policy's own memory, `[*batch ...]`; None for a policy without one."""
    action: Float[Array, "*batch action"]
    """The last action; 0 at the start of a trial."""
    reward: Float[Array, "*batch"]
    """The last reward, as it was shown; 0 at the start of a trial."""

    def after(
        self,
        hidden: Carry,
        action: Float[Array, "time action"],
        observed_reward: Float[Array, " time"],
        valid: Bool[Array, " time"],
    ) -> "TrialState":
        """Return the memory after one more episode; what is invalid is not remembered.

        Args:
            hidden: the policy's own memory after the episode.
            action: actions of the episode.
            observed_reward: rewards of the episode, as they were shown.
            valid: which of its steps were played.
        """
        last = jnp.maximum(valid.sum() - 1, 0)
        return TrialState(
            hidden,
            jnp.where(valid.any(), action[last], self.action),
            jnp.where(valid.any(), observed_reward[last], self.reward),
        )


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
    """Whether the episode starts in the goal region: what is solved then, nobody has solved."""
    terminated: Bool[Array, "*batch"]
    """Whether the episode ended by nature rather than by the clock."""
    noise: Float[Array, "*batch noise"]
    """The standard normal draw behind the context of the episode; its description if it is told."""
    context: Float[Array, "*batch context"]
    """What the policy was fed throughout the episode: the recorded latent z."""
    behaviour: AbstractDistribution
    """The distribution that each action was drawn from, `[*batch time action]`."""
    carry: TrialState | None
    """Memory after the last step, to go on from in the next episode of the trial."""
    start: TrialState | None = None
    """Memory before the first step; None at the start of a trial of a policy without memory."""
    observed_reward: Float[Array, "*batch time"] | None = None
    """r_t as it was shown to the policy; None if that is `reward`."""

    def policy_inputs(self) -> PolicyInput:
        """Return what the policy was told at every step, `[*batch time ...]`; 0 where invalid."""
        steps = self.action.shape[-2]
        rewards = self.reward if self.observed_reward is None else self.observed_reward
        first_action, first_reward = (
            jnp.zeros_like(self.action[..., 0, :]),
            jnp.zeros_like(rewards[..., 0]),
        )
        if self.start is not None:
            first_action, first_reward = self.start.action, self.start.reward
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
        before, and a policy with memory needs all steps, a stride of 1. `observation` keeps no
        final state: it has as many entries as `action`.
        """
        time = self.action.shape[-2]
        stride = min(stride, time)
        steps = time // stride
        start = jnp.asarray(offset)

        def thin(x: Array, axis: int) -> Array:
            indices = start + stride * jnp.arange(steps)
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
            context=self.context,
            behaviour=jax.tree.map(lambda x: thin(x, batch_rank), self.behaviour),
            carry=None,
            start=self.start if stride == 1 else None,
            observed_reward=jax.tree.map(lambda x: thin(x, batch_rank), self.observed_reward),
        )


def concatenate(first: Episodes, second: Episodes) -> Episodes:
    """Join two batches of the same tasks along the `episode` axis."""
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b], axis=1), first, second)


@runtime_checkable
class Collect(Protocol):
    """Plays episodes; all that a learner knows of the world."""

    @property
    def num_tasks(self) -> int:
        """Number of tasks that can be asked for."""

    def __call__(
        self, keys: TaskKeys, agents: Agents, task_index: Int[Array, " task"], carry: Carry = None
    ) -> Episodes:
        """Play a fixed number of episodes of each task.

        Args:
            keys: one key per task slot. All randomness of slot i comes from `keys[i]`, so what is
                played in it depends neither on the other slots nor on how many there are.
            agents: one agent per task slot.
            task_index: which task each slot plays.
            carry: memory of the trials that go on, `[task, episode, ...]`, as `Episodes.carry` of
                the episodes before; None to start trials afresh.

        Returns:
            Episodes with the leading axes `task episode`.
        """
