"""The state of a trial between two of its episodes."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import RecurrentState


class TrialState(eqx.Module):
    """State that an episode passes on to the next one of its trial."""

    recurrent_state: RecurrentState
    """The policy's own, `[*batch ...]`; None for a policy that is not recurrent."""
    action: Float[Array, "*batch action"]
    """The last action; 0 at the start of a trial."""
    reward: Float[Array, "*batch"]
    """The last reward that the policy received; 0 at the start of a trial."""

    def after(
        self,
        recurrent_state: RecurrentState,
        action: Float[Array, "time action"],
        observed_reward: Float[Array, " time"],
        valid: Bool[Array, " time"],
    ) -> "TrialState":
        """Return the state after one more episode, whose invalid steps do not change it.

        The recurrent state is the policy's own after the episode; rewards are as it received them.
        """
        last = jnp.maximum(valid.sum() - 1, 0)
        return TrialState(
            recurrent_state,
            jnp.where(valid.any(), action[last], self.action),
            jnp.where(valid.any(), observed_reward[last], self.reward),
        )
