"""A batch of episodes, and the function that plays one: all that learning sees of the world."""

from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from maesn.agent import Agents
from maesn.axes import Carry, TaskKeys
from maesn.numerics import AbstractDistribution


class Episodes(eqx.Module):
    """Episodes of fixed length, masked by `valid`.

    The leading axes `*batch` are `task episode` in a collected batch and `episode` for one task.
    What happens after an episode has ended is garbage and must change nothing.
    """

    observation: Float[Array, "*batch time_plus_1 observation"]
    """o_0 ... o_T. The last one is needed for bootstrapping and for models of the dynamics."""
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
    terminated: Bool[Array, "*batch"]
    """Whether the episode ended by nature rather than by the clock."""
    noise: Float[Array, "*batch noise"]
    """The standard normal draw behind the context of the episode."""
    context: Float[Array, "*batch context"]
    """What the policy was fed throughout the episode: the recorded latent z."""
    behaviour: AbstractDistribution
    """The distribution that each action was drawn from, `[*batch time action]`."""
    carry: Carry
    """Memory of the policy after the last step, `[*batch ...]`; None without memory."""

    @property
    def undiscounted_return(self) -> Float[Array, "*batch"]:
        """sum_t r_t over the valid steps."""
        return jnp.where(self.valid, self.reward, 0.0).sum(-1)

    def every(self, stride: int, offset: int | Array) -> "Episodes":
        """Return every `stride`-th step, starting at step `offset` in [0, stride + time % stride).

        Neighbouring steps of an episode resemble each other, so an average over the thinned steps
        is nearly as good as one over all. What needs whole episodes (returns) must be computed
        before. `observation` keeps no final state: it has as many entries as `action`.
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
            terminated=self.terminated,
            noise=self.noise,
            context=self.context,
            behaviour=jax.tree.map(lambda x: thin(x, batch_rank), self.behaviour),
            carry=None,
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
            carry: memory that the policies start with, `[task, episode, ...]`; None to start a
                trial afresh.

        Returns:
            Episodes with the leading axes `task episode`.
        """
