"""What changes while VariBAD trains, and what a meta-iteration tells of it."""

from typing import Any

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from maesn.learners.trial_meta import TrialInfo
from maesn.learners.trial_value import ValueState
from maesn.learners.varibad.bonus import BonusState
from maesn.learners.varibad.decoder import Decoder
from maesn.learners.varibad.inference import InferenceInfo
from maesn.learners.varibad.policy import BeliefPolicy
from maesn.learners.varibad.steps import TrialBuffer


class BeliefNetworks(eqx.Module):
    """The policy with its belief, and what the belief predicts."""

    policy: BeliefPolicy
    decoder: Decoder


class VaribadState(eqx.Module):
    """State of a `VaribadMetaLearner`."""

    networks: BeliefNetworks
    opt_state: Any
    """State of the policy's optimiser."""
    inference: Any
    """State of Adam of encoder and decoder."""
    value: ValueState
    bonus: BonusState | None
    buffer: TrialBuffer
    iteration: Int[Array, ""]


class VaribadInfo(TrialInfo):
    """Info of one meta-iteration: scalars only."""

    bonus: Float[Array, ""]
    """Mean bonus of a step, in the unit of rewards."""
    explained_variance: Float[Array, ""]
    """Share of the variance of the returns that the value function explained before the fit."""
    value_accepted: Bool[Array, ""]
    """False if the fitted value function was not finite: it stays as it was."""
    policy_step: Any
    """Info of the policy's step."""
    inference: InferenceInfo
    inference_accepted: Bool[Array, ""]
    """False if encoder or decoder were not finite: they stay as they were."""
