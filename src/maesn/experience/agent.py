"""An agent: a policy and one task's context. All that an inner update may change."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from maesn.axes import RecurrentState
from maesn.context import AbstractContext
from maesn.numerics.normalization import ObservationStatistics
from maesn.numerics.tasks import How, map_tasks
from maesn.policies import AbstractPolicy, PolicyInput


class Agent(eqx.Module):
    """A policy with the context of one task."""

    policy: AbstractPolicy
    context: AbstractContext
    statistics: ObservationStatistics | None = None
    """Normalise the observations before the policy sees them; None leaves them as they are."""

    def perceive(self, received: PolicyInput) -> PolicyInput:
        """Return the policy's input with its observation normalised."""
        if self.statistics is None:
            return received
        return received._replace(observation=self.statistics.normalized(received.observation))


class TrialState(eqx.Module):
    """State that an episode passes on to the next one of its trial."""

    recurrent_state: RecurrentState
    """The policy's own, `[*batch ...]`; None for a policy that is not recurrent."""
    action: Float[Array, "*batch action"]
    """The last action; 0 at the start of a trial."""
    reward: Float[Array, "*batch"]
    """The last reward that the policy received; 0 at the start of a trial."""


class Agents(eqx.Module):
    """One agent per task slot.

    As long as no inner update changes the policy's weights, all agents share one copy of them. That
    saves memory and time: a product with shared weights is one matrix product over the whole batch,
    and not a batch of small ones, where the tasks are mapped at once.
    """

    policy: AbstractPolicy
    """Weights, with a leading `task` axis unless `shares_policy`."""
    context: AbstractContext
    """Contexts, with a leading `task` axis."""
    shares_policy: bool = eqx.field(static=True)
    statistics: ObservationStatistics | None = None
    """Shared by all tasks; no inner update changes them."""
    trial_state: TrialState | None = None
    """State from which the trials continue, `[task, episode, ...]`: `Episodes.trial_end` of the
    previous episodes. None starts new trials."""
    is_noisy: bool = eqx.field(static=True, default=True)
    """Whether actions are drawn at random. If not, each is the `mode` of its distribution."""

    def at_mean(self) -> "Agents":
        """Return the same agents, with every context held at its mean."""
        return replace(self, context=self.context.at_mean())

    def parts(self) -> tuple[Any, Any]:
        """Split into what all tasks share and what has a row per task; `of_parts` joins them."""
        shared, own = (self.policy, None) if self.shares_policy else (None, self.policy)
        return (shared, self.statistics), (own, self.context, self.trial_state)

    @staticmethod
    def of_parts(shared: Any, rows: Any) -> "Agents":
        """Join the results of `parts`. A policy per task replaces a shared one."""
        (policy, statistics), (own, context, trial_state) = shared, rows
        shares_policy = own is None
        return Agents(
            policy if shares_policy else own, context, shares_policy, statistics, trial_state
        )

    def map(self, function: Callable[..., Any], *rows: Any, how: How = "serial") -> Any:
        """Map `function(agent, *row)`, written for one task, over the tasks; see `map_tasks`.

        Other arguments, and what is returned, have a leading `task` axis.
        """

        def one(policy: AbstractPolicy | None, context: AbstractContext, *row: Any) -> Any:
            own = self.policy if policy is None else policy
            return function(Agent(own, context, self.statistics), *row)

        policies = None if self.shares_policy else self.policy
        return map_tasks(one, policies, self.context, *rows, how=how)
