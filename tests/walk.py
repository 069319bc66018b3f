"""A method of somebody's own, as a file of theirs: a random walk that remembers where it was."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from maesn.axes import Key
from maesn.experience.episodes import Collect
from maesn.learners import AbstractFastLearner, AbstractMetaLearner, Problem, baselines


class Stride(eqx.Module):
    """Settings of a slot."""

    length: float = 1.0


class WalkState(eqx.Module):
    position: Float[Array, " 3"]
    visits: Int[Array, ""]
    """A statistic of training."""
    past: Float[Array, "row 3"]
    """Replay."""
    iteration: Int[Array, ""]


class Walk(AbstractMetaLearner[WalkState, dict[str, Array]]):
    """Learns nothing, but compiles at once."""

    stride: Stride = Stride()
    memory: int = 4
    """Positions that the replay holds."""

    def init(self, key: Key, problem: Problem) -> WalkState:
        past = jnp.zeros((self.memory, 3))
        return WalkState(jnp.zeros(3), jnp.zeros((), int), past, jnp.zeros((), int))

    def step(self, key: Key, state: WalkState, collect: Collect) -> tuple[WalkState, Any]:
        drawn = self.stride.length * jax.random.normal(key, (3,))
        moved = state.position + drawn + 0.1 * state.past.mean(0)
        past = jnp.roll(state.past, 1, axis=0).at[0].set(moved)
        after = WalkState(moved, state.visits + 1, past, state.iteration + 1)
        return after, {"distance": jnp.linalg.norm(moved)}

    def iteration(self, state: WalkState) -> Int[Array, ""]:
        return state.iteration

    def weights(self, state: WalkState) -> Array:
        return state.position

    def replay(self, state: WalkState) -> Array:
        return state.past

    def planned_episodes(self, episodes_per_task: int, iterations: int) -> int:
        return iterations * episodes_per_task

    def fast_learner(self, state: WalkState) -> AbstractFastLearner[Any]:
        return baselines(2, 2, "continuous")["random actions"]


long_walk = Walk(Stride(10.0))
not_a_method = 3
