"""Replay: the last transitions of every training task, and which of them are its context.

A task has one ring of transitions. The critics learn from all of it. The context is drawn from the
latest visit to the task alone, because the policy that adapts in a new task is the latest one; the
reference keeps a second buffer for that.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import Key
from maesn.experience.episodes import Episodes
from maesn.numerics import Ring


class Batch(NamedTuple):
    """Transitions, with any leading axes."""

    observation: Float[Array, "*batch observation"]
    action: Float[Array, "*batch action"]
    reward: Float[Array, "*batch"]
    """The reward that training learns from."""
    context_reward: Float[Array, "*batch"]
    """The reward that the context shows."""
    next_observation: Float[Array, "*batch observation"]
    terminal: Float[Array, "*batch"]
    """1 where the episode ended by the task's own rules, so that no reward can follow; else 0."""

    def context(self, with_next: bool) -> Float[Array, "*batch feature"]:
        """Return what the encoder sees of transitions; `with_next`: next observations as well."""
        parts = [self.observation, self.action, self.context_reward[..., None]]
        return jnp.concatenate(parts + [self.next_observation] * with_next, axis=-1)


class Replay(eqx.Module):
    """The transitions of all training tasks. Its memory is bounded from the start."""

    rings: Ring
    """One ring per task: a `Batch` of `[task, capacity, ...]`, and `count[task]`."""
    context_start: Int[Array, " row"]
    """Transitions that were added to each task's ring before its latest visit."""
    context_end: Int[Array, " row"]
    """The same, up to the end of the context of that visit."""

    @staticmethod
    def empty(num_tasks: int, capacity: int, observation_size: int, action_size: int) -> "Replay":
        """Return a replay without transitions, `capacity` of which fit per task."""
        observation, number = jnp.zeros(observation_size), jnp.zeros(())
        row = Batch(observation, jnp.zeros(action_size), number, number, observation, number)
        ring = Ring.empty(capacity, row)
        rings = jax.tree.map(lambda x: jnp.zeros((num_tasks, *x.shape), x.dtype), ring)
        return Replay(rings, rings.count, rings.count)

    @property
    def is_played(self) -> Bool[Array, " row"]:
        """Whether there is a context of each task."""
        return self.context_end > self.context_start

    @eqx.filter_jit
    def add(
        self, tasks: Int[Array, " task"], episodes: Episodes, *, begins: bool, is_context: bool
    ) -> "Replay":
        """Append episodes.

        Args:
            tasks: the training tasks that were played, all different.
            episodes: their episodes, `[task, episode, ...]`.
            begins: whether a visit to the tasks begins, and with it their contexts.
            is_context: whether the episodes are part of the context. Within a visit, those that are
                come first.
        """
        batch, valid = transitions_of(episodes)
        rings = jax.tree.map(lambda x: x[tasks], self.rings)
        extended = jax.vmap(Ring.extend)(rings, batch, valid)
        start = rings.count if begins else self.context_start[tasks]
        usual = rings.count if begins else self.context_end[tasks]
        end = extended.count if is_context else usual
        return Replay(
            jax.tree.map(lambda all_, some: all_.at[tasks].set(some), self.rings, extended),
            self.context_start.at[tasks].set(start),
            self.context_end.at[tasks].set(end),
        )

    def sample(self, key: Key, tasks: Int[Array, " task"], number: int) -> Batch:
        """Draw transitions of each task uniformly, with replacement: `[task, number, ...]`."""
        count = self.rings.count[tasks]
        return self._draw(key, tasks, count - self.rings.size[tasks], count, number)

    def sample_context(self, key: Key, tasks: Int[Array, " task"], number: int) -> Batch:
        """Draw transitions of each task's context uniformly, with replacement."""
        oldest = self.rings.count[tasks] - self.rings.capacity
        start = jnp.maximum(self.context_start[tasks], oldest)
        return self._draw(key, tasks, start, self.context_end[tasks], number)

    def _draw(
        self,
        key: Key,
        tasks: Int[Array, " task"],
        start: Int[Array, " task"],
        end: Int[Array, " task"],
        number: int,
    ) -> Batch:
        share = jax.random.uniform(key, (tasks.shape[0], number))
        length = jnp.maximum(end - start, 1)[:, None]
        # Rounding could make a share of 1 of it.
        offset = jnp.minimum((share * length.astype(float)).astype(int), length - 1)
        place = (start[:, None] + offset) % self.rings.capacity
        return jax.tree.map(lambda x: x[tasks[:, None], place], self.rings.rows)


def transitions_of(episodes: Episodes) -> tuple[Batch, Bool[Array, "task transition"]]:
    """Return the transitions `[task, episode * time, ...]` of episodes, and which of them count.

    Steps after the end of an episode do not count, nor those into a state that is not finite,
    unless the episode terminates there.
    """
    valid = episodes.valid
    is_last = valid & ~jnp.concatenate([valid[..., 1:], jnp.zeros_like(valid[..., :1])], axis=-1)
    terminal = is_last & episodes.terminated[..., None]
    before, after = episodes.observation[..., :-1, :], episodes.observation[..., 1:, :]
    counts = valid & (jnp.isfinite(after).all(-1) | terminal)

    def numbers(x: Array) -> Array:
        mask = counts if x.ndim == counts.ndim else counts[..., None]
        # Where an episode terminates, what follows need not be finite and is never read.
        return jnp.where(mask & jnp.isfinite(x), x, 0.0)

    batch = Batch(
        before,
        episodes.action,
        episodes.reward,
        episodes.received_reward,
        after,
        terminal.astype(before.dtype),
    )
    tasks = valid.shape[0]
    flat = Batch(*(numbers(x).reshape(tasks, -1, *x.shape[valid.ndim :]) for x in batch))
    return flat, counts.reshape(tasks, -1)
