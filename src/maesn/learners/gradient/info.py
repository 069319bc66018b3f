"""The info of one meta-iteration, for logs and people."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from maesn.inner.adaptation import StepSizes
from maesn.learners.gradient.objective import MetaObjective, MetaParameters
from maesn.numerics import mesh


class GroupShares(eqx.Module):
    """Shares of the squared length of the outer step that fall on each group; they sum to 1.

    Directions in which the policy has no curvature are held by damping alone. The shares show
    whether the step spends itself on them.
    """

    policy: Float[Array, ""]
    context: Float[Array, ""]
    step_sizes: Float[Array, ""]


class GradientInfo(eqx.Module):
    """Info of one meta-iteration: scalars only."""

    return_before: Float[Array, ""]
    """Mean undiscounted return before the inner updates."""
    return_after: Float[Array, ""]
    """Mean undiscounted return after them."""
    success_after: Float[Array, ""]
    """Share of the episodes after adaptation that reach the goal region."""
    penalty: Float[Array, ""]
    """Mean penalty of the pre-update contexts (weighted KL to the prior)."""
    action_std: Float[Array, ""]
    """Mean standard deviation of the actions after adaptation."""
    outer: Any
    """What the outer step tells."""
    shares: GroupShares
    step_sizes: StepSizes
    """Mean of the learned step sizes of every array of parameters."""
    nonfinite_tasks: Int[Array, ""]
    """Number of tasks whose surrogate loss was not finite; the step was then rejected."""
    first_nonfinite_task: Int[Array, ""]
    """Index of one of them in the training set; -1 if there is none."""


def describe_step(
    objective: MetaObjective, old: MetaParameters, new: MetaParameters, step: Any
) -> GradientInfo:
    """Return the scalars that describe one outer step from `old` to `new`."""
    post = objective.post
    first = objective.pre[0][0] if objective.pre else post
    count, first_task = _nonfinite_tasks(objective, old, step.loss_before)
    return GradientInfo(
        return_before=mesh.mean(first.undiscounted_return.mean()),
        return_after=mesh.mean(post.undiscounted_return.mean()),
        success_after=mesh.mean(post.success.mean()),
        penalty=mesh.mean(objective.penalties(old).mean()),
        action_std=mesh.mean_of_valid(post.behaviour.std().mean(-1), post.valid),
        outer=step,
        shares=_group_shares(old, new),
        step_sizes=jax.tree.map(lambda x: x.mean() if x.size else jnp.zeros(()), new.step_sizes),
        nonfinite_tasks=count,
        first_nonfinite_task=first_task,
    )


def _group_shares(old: MetaParameters, new: MetaParameters) -> GroupShares:
    def squared(before: Any, after: Any) -> Float[Array, ""]:
        parts = jax.tree.map(lambda a, b: jnp.sum((b - a) ** 2), before, after)
        return sum(jax.tree.leaves(parts), jnp.zeros(()))

    policy = squared(old.policy, new.policy)
    context = squared(old.context_table, new.context_table)
    sizes = squared(old.step_sizes, new.step_sizes)
    total = policy + context + sizes
    scale = jnp.where(total > 0, 1.0 / jnp.where(total > 0, total, 1.0), 0.0)
    return GroupShares(policy * scale, context * scale, sizes * scale)


def _nonfinite_tasks(
    objective: MetaObjective, parameters: MetaParameters, loss: Float[Array, ""]
) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """Return number and first index of the tasks whose loss is not finite.

    The tasks' losses are evaluated only if their mean is not finite.
    """

    def search() -> tuple[Int[Array, ""], Int[Array, ""]]:
        broken = mesh.gather(~jnp.isfinite(objective.of_tasks(parameters).loss))
        index = mesh.gather(objective.index)
        return broken.sum(), jnp.where(broken.any(), index[broken.argmax()], -1)

    nothing = (jnp.zeros((), int), jnp.full((), -1, int))
    return jax.lax.cond(jnp.isfinite(loss), lambda: nothing, search)
