"""The inner update: which parts of an agent change in a new task, and how far."""

import math
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from maesn.context import AbstractContextSettings
from maesn.experience.agent import Agent, Agents
from maesn.experience.episodes import Episodes
from maesn.inner.advantage import Advantages
from maesn.inner.surrogate import inner_loss
from maesn.settings import check_number, check_positive


class InnerStep(eqx.Module):
    """The inner update of one part of an agent, along its policy gradient."""

    initial_size: float = 1.0
    """Step size of every parameter before training."""
    learned: bool = True
    """Whether the step size of each parameter is meta-learned. The paper calls this crucial."""
    first_iteration: int = 0
    """First meta-iteration in which this part moves, for stage-wise training."""

    def __check_init__(self) -> None:
        if not math.isfinite(self.initial_size):
            raise ValueError(f"`initial_size` must be finite, got {self.initial_size}.")
        check_number("first_iteration", self.first_iteration, 0)


class StepSizes(eqx.Module):
    """Step sizes, one per parameter; `None` for a part that has none."""

    policy: Any
    """Same structure as the policy of one agent."""
    context: Any
    """Same structure as the context of one task; shared by all tasks."""


class Adaptation(eqx.Module):
    """One step of policy gradient on the parts that have an `InnerStep`.

    parameter' = parameter - step size * d(inner loss)/d(parameter), elementwise
    (equations (4) to (6); the third one, for the policy, is optional there and omitted by MAESN).
    """

    policy: InnerStep | None = None
    """How the policy's weights move; None to leave them alone."""
    context: InnerStep | None = None
    """How the context moves; None to leave it alone."""

    def init(self, agent: Agent) -> StepSizes:
        """Return the step sizes that are to be meta-learned.

        Args:
            agent: one task's agent, for its structure.
        """
        return StepSizes(
            policy=_initial_sizes(self.policy, agent.policy, learned=True),
            context=_initial_sizes(self.context, agent.context, learned=True),
        )

    def least_episodes(self, context: AbstractContextSettings[Any]) -> int:
        """Return the number of episodes per task below which a step cannot change anything.

        A latent that moves by its likelihood ratio compares the returns of episodes. Of a single
        one the standardised advantage is 0, and nothing moves unless the policy does.
        """
        compares = self.context is not None and not context.is_pathwise
        return 2 if compares and self.policy is None else 1

    def at(self, iteration: int) -> "Adaptation":
        """Return the adaptation of one meta-iteration: without the parts whose stage is to come."""
        return Adaptation(
            policy=_if_begun(self.policy, iteration), context=_if_begun(self.context, iteration)
        )

    def __call__(
        self,
        agents: Agents,
        sizes: StepSizes,
        context: AbstractContextSettings[Any],
        episodes: Episodes,
        advantages: Advantages,
        scale: float | Float[Array, ""] = 1.0,
    ) -> Agents:
        """Move every task's agent once. Differentiable in the agents and in the step sizes.

        Episodes are those that the agents played, `[task, episode, ...]`, with their advantages.
        Of the step sizes, parts that are fixed are ignored; `scale` multiplies every one.
        """
        moved_policy, moved_context = agents.map(
            lambda agent, played, advantage: self.moved_parts(
                agent, sizes, context, played, advantage, scale
            ),
            episodes,
            advantages,
        )
        return replace(
            agents,
            policy=agents.policy if self.policy is None else moved_policy,
            context=agents.context if self.context is None else moved_context,
            shares_policy=agents.shares_policy and self.policy is None,
        )

    def moved_parts(
        self,
        agent: Agent,
        sizes: StepSizes,
        context: AbstractContextSettings[Any],
        episodes: Episodes,
        advantages: Advantages,
        scale: float | Float[Array, ""] = 1.0,
    ) -> tuple[Any, Any]:
        """Return the moved parts (policy, context) of one agent; None for a part that stays.

        As for a call, without the axis of tasks.
        """

        def loss(parts: tuple[Any, Any]) -> Float[Array, ""]:
            policy, value = parts
            moving = Agent(
                agent.policy if policy is None else policy,
                agent.context if value is None else value,
                agent.statistics,
            )
            return inner_loss(moving, context, episodes, advantages)

        parts = (
            None if self.policy is None else agent.policy,
            None if self.context is None else agent.context,
        )
        part_sizes = (
            _sizes_of(self.policy, agent.policy, sizes.policy),
            _sizes_of(self.context, agent.context, sizes.context),
        )
        return jax.tree.map(
            lambda x, size, slope: x - scale * size * slope,
            parts,
            part_sizes,
            jax.grad(loss)(parts),
        )


def _initial_sizes(step: InnerStep | None, part: Any, *, learned: bool) -> Any:
    """Return step sizes in the structure of `part`, or None if there are none of this kind."""
    if step is None or step.learned != learned:
        return None
    return jax.tree.map(lambda x: jnp.full_like(x, step.initial_size), part)


def _sizes_of(step: InnerStep | None, part: Any, learned_sizes: Any) -> Any:
    if step is not None and step.learned:
        return learned_sizes
    return _initial_sizes(step, part, learned=False)


def _if_begun(step: InnerStep | None, iteration: int) -> InnerStep | None:
    return step if step is not None and iteration >= step.first_iteration else None


class StepSchedule(eqx.Module):
    """Step sizes in a new task: full steps first, then each half of the one before.

    With two full steps the sizes are a, a, a/2, a/4, ...; the latents hardly move after about
    eight updates. Source: the reference's test script, which halves the step after every update
    but the first.
    """

    full_steps: int = 2
    """Number of first updates with the whole step size. Reference: 2 for MAESN, 3 for
    LatentSpace."""
    factor: float = 0.5
    """Factor on the step size from each later update to the next. 1: the size stays."""
    scale: float = 1.0
    """Factor on all step sizes."""

    def __check_init__(self) -> None:
        check_number("full_steps", self.full_steps, 1)
        if not 0 < self.factor <= 1:
            raise ValueError(f"`factor` must lie in (0, 1], got {self.factor}.")
        check_positive(self, "scale")

    def __call__(self, update: Array) -> Float[Array, ""]:
        """Return the scale of the step sizes in update number 0, 1, ..."""
        decays = jnp.maximum(update - (self.full_steps - 1), 0)
        return self.scale * self.factor ** decays.astype(float)
