"""An agent: a policy and one task's context. All that an inner step may change."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax

from maesn.context import AbstractContext
from maesn.experience.trial_state import TrialState
from maesn.numerics.normalization import ObservationStatistics
from maesn.policies import AbstractPolicy, PolicyInput


class Agent(eqx.Module):
    """What acts in one task."""

    policy: AbstractPolicy
    context: AbstractContext
    statistics: ObservationStatistics | None = None
    """By which observations are normalised before the policy sees them; None for not at all."""

    def perceive(self, received: PolicyInput) -> PolicyInput:
        """Return what the policy sees of what the world tells: observations are normalised."""
        if self.statistics is None:
            return received
        return received._replace(observation=self.statistics.normalized(received.observation))


class Agents(eqx.Module):
    """One agent per task slot.

    Methods that leave the policy's weights alone in their inner step share one copy of them. This
    is not only smaller: a product with shared weights is one matrix product over the whole batch,
    where stacked weights make it a batch of small ones, as long as the tasks are mapped at once.
    """

    policy: AbstractPolicy
    """Weights, with a leading `task` axis unless `shares_policy`."""
    context: AbstractContext
    """Contexts, with a leading `task` axis."""
    shares_policy: bool = eqx.field(static=True)
    statistics: ObservationStatistics | None = None
    """Shared by all tasks, and changed by no inner step."""
    trial_state: TrialState | None = None
    """Where the trials go on, `[task, episode, ...]`: `Episodes.trial_end` of the episodes before.
    None to begin new trials."""

    def at_mean(self) -> "Agents":
        """Return the same agents, with every context held at its mean."""
        return replace(self, context=self.context.at_mean())

    def vmap(self, function: Callable[..., Any], in_axes: Any = 0) -> Callable[..., Any]:
        """Map `function(agent, *rest)` over the tasks.

        Args:
            function: written for one task; its first argument is an `Agent`.
            in_axes: axes of the remaining arguments, as one value for all or a tuple.

        Returns:
            A function of the remaining arguments, each with a leading `task` axis.
        """

        def mapped(*rest: Any) -> Any:
            axes = in_axes if isinstance(in_axes, tuple) else (in_axes,) * len(rest)
            policy_axis = None if self.shares_policy else 0
            return jax.vmap(
                lambda policy, context, *args: function(
                    Agent(policy, context, self.statistics), *args
                ),
                in_axes=(policy_axis, 0, *axes),
            )(self.policy, self.context, *rest)

        return mapped

    def one_by_one(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Do the same as `vmap`, one task after the other.

        On a CPU an inner step through the policy takes half of the time that way, because the
        activations of one task fit in its cache, and those of all do not.

        Args:
            function: written for one task; its first argument is an `Agent`.

        Returns:
            A function of the remaining arguments, each with a leading `task` axis.
        """

        def mapped(*rest: Any) -> Any:
            def one(row: tuple[Any, ...]) -> Any:
                policy, context, *args = row
                own = self.policy if self.shares_policy else policy
                return function(Agent(own, context, self.statistics), *args)

            policies = None if self.shares_policy else self.policy
            return jax.lax.map(one, (policies, self.context, *rest))

        return mapped
