"""Batches of episodes, and the function that plays them. Learners see nothing else of a world."""

from dataclasses import replace
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import Key, TaskKeys
from maesn.experience.agent import Agents, TrialState
from maesn.numerics import AbstractDistribution, mesh
from maesn.policies import PolicyInput


class Thinning(NamedTuple):
    """A choice of every `stride`-th time step of an episode, from step `offset` on."""

    stride: int
    offset: int | Int[Array, ""]
    """From 0 to stride - 1 + time % stride, for episodes of `time` steps."""

    @staticmethod
    def draw(key: Key, stride: int, valid: Bool[Array, "*batch time"]) -> "Thinning":
        """Draw the offset, a step that some episode has reached; any played step can be chosen."""
        time = valid.shape[-1]
        stride = min(stride, time)
        # The remainder lets offsets reach the last steps where the stride does not divide the time.
        offset = jax.random.randint(key, (), 0, stride + time % stride)
        played = mesh.total(valid.reshape(-1, time).any(0).astype(int)) > 0
        return Thinning(stride, offset % jnp.maximum(played.sum(), 1))

    def take(self, x: Array, axis: int) -> Array:
        """Return the chosen steps of an array with the time along `axis`."""
        time = x.shape[axis]
        stride = min(self.stride, time)
        steps = jnp.asarray(self.offset) + stride * jnp.arange(time // stride)
        return jnp.take(x, steps, axis=axis)


class Episodes(eqx.Module):
    """Episodes of fixed length, masked by `valid`.

    The leading axes `*batch` are `task episode` in a collected batch and `episode` for one task.
    Values after the end of an episode are arbitrary. No result may depend on them.
    """

    observation: Float[Array, "*batch time_plus_1 observation"]
    """o_0 ... o_T. The last one is needed for bootstrapping and for models of the dynamics.

    The state that terminates an episode need not be finite, so mask o_{t+1} where you read it."""
    action: Float[Array, "*batch time action"]
    """The policy's own actions, before the environment clips or scales them."""
    reward: Float[Array, "*batch time"]
    """r_t, for the step from o_t to o_{t+1}."""
    goal_reward: Float[Array, "*batch time"]
    """The part of `reward` that is due to the goal: without control and survival terms."""
    valid: Bool[Array, "*batch time"]
    """True where step t was played: the episode had not ended before it."""
    solved: Bool[Array, "*batch time"]
    """Whether the state after step t lies in the goal region."""
    solved_at_start: Bool[Array, "*batch"]
    """Whether the episode starts in the goal region, which is no success of the policy."""
    terminated: Bool[Array, "*batch"]
    """Whether the episode ended by the task's own rules, and not by running out of time."""
    noise: Float[Array, "*batch noise"]
    """The standard normal noise of z; no components if z is not random."""
    description: Float[Array, "*batch description"]
    """The description of the task, for an oracle; else no components."""
    z: Float[Array, "*batch z"]
    """The context's input to the policy, constant during the episode."""
    behaviour: AbstractDistribution
    """The distribution that each action was drawn from, `[*batch time action]`."""
    trial_end: TrialState | None
    """State of the trial after the last step, from which the trial's next episode continues."""
    trial_start: TrialState | None = None
    """State before the first step; None where a trial of a non-recurrent policy begins."""
    observed_reward: Float[Array, "*batch time"] | None = None
    """r_t as the policy received it; None if that is `reward`."""

    @property
    def received_reward(self) -> Float[Array, "*batch time"]:
        """r_t as the policy received it."""
        return self.reward if self.observed_reward is None else self.observed_reward

    def policy_inputs(self) -> PolicyInput:
        """Return the policy's inputs at every step, `[*batch time ...]`; 0 where invalid."""
        action, reward, time = self.action, self.received_reward, self.action.shape[-2]
        start = self.trial_start
        if start is None:
            start = TrialState(
                None, jnp.zeros_like(action[..., 0, :]), jnp.zeros_like(reward[..., 0])
            )
        previous_action = jnp.concatenate(
            [start.action[..., None, :], action[..., :-1, :]], axis=-2
        )
        previous_reward = jnp.concatenate([start.reward[..., None], reward[..., :-1]], axis=-1)
        # Zeros, because the gradient of a masked NaN is NaN.
        return PolicyInput(
            observation=jnp.where(self.valid[..., None], self.observation[..., :time, :], 0.0),
            previous_action=jnp.where(self.valid[..., None], previous_action, 0.0),
            previous_reward=jnp.where(self.valid, previous_reward, 0.0),
            episode_start=self.valid.at[..., 1:].set(False),
        )

    @property
    def undiscounted_return(self) -> Float[Array, "*batch"]:
        """sum_t r_t over the valid steps."""
        return jnp.where(self.valid, self.reward, 0.0).sum(-1)

    @property
    def success(self) -> Bool[Array, "*batch"]:
        """Whether a valid step leads into the goal region."""
        return (self.solved & self.valid).any(-1)

    def every(self, stride: int, offset: int | Array) -> "Episodes":
        """Return the steps that `Thinning(stride, offset)` chooses.

        Neighbouring steps of an episode resemble each other, so an average over the chosen steps is
        nearly as good as one over all. Compute returns before, because they need all steps. So does
        a recurrent policy: its stride must be 1. `observation` keeps no final state: it has as many
        steps as `action`.
        """
        time, time_axis = self.action.shape[-2], self.terminated.ndim
        thinning = Thinning(min(stride, time), offset)

        def thin(tree: Any) -> Any:
            return jax.tree.map(lambda x: thinning.take(x, time_axis), tree)

        return replace(
            self,
            observation=thin(self.observation[..., :time, :]),
            action=thin(self.action),
            reward=thin(self.reward),
            goal_reward=thin(self.goal_reward),
            valid=thin(self.valid),
            solved=thin(self.solved),
            behaviour=thin(self.behaviour),
            trial_end=None,
            trial_start=self.trial_start if thinning.stride == 1 else None,
            observed_reward=thin(self.observed_reward),
        )


def concatenate(*batches: Episodes) -> Episodes:
    """Join batches of the same tasks along the `episode` axis."""
    joined: Episodes = jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=1), *batches)
    return joined


@runtime_checkable
class Collect(Protocol):
    """Plays episodes, the only access of a learner to a world."""

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
            keys: one key per task slot. All randomness of slot i comes from `keys[i]`, so its
                episodes depend neither on the other slots nor on their number.
            agents: one agent per task slot. Their trials continue from `agents.trial_state`.
            task_index: the task that each slot plays.
            stage: number of earlier inner updates, or of earlier episodes of the trial. It does not
                change the episodes; wrappers tell batches apart by it.

        Returns:
            Episodes with the leading axes `task episode`.
        """
