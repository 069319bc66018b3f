"""Settings that mean nothing are refused by their name."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from maesn import (
    BeliefDecoderSettings,
    BeliefEncoderSettings,
    BeliefInference,
    HyperBonus,
    ProximalOuterStep,
    ProximalStep,
    RecurrentValue,
    TrustRegionOuterStep,
    TrustRegionStep,
    maesn,
    pearl,
    rl2,
    varibad,
)
from maesn.context import BiasContext, LatentContext
from maesn.inner.adaptation import InnerStep, StepSchedule
from maesn.inner.advantage import AdvantageEstimator
from maesn.learners import CuriosityBonus, GradientStep
from maesn.learners.pearl.encoder import EncoderSettings
from maesn.learners.pearl.sac import SoftActorCritic
from maesn.numerics import MinibatchDescent
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import AnnealedGaussianMLP, CategoricalMLP, GaussianMLP, Recurrent
from maesn.rules import GradientRule, ThenTrpo
from maesn.runs.config import RunSettings
from maesn.runtime.search import SearchSettings
from maesn.search.prior import PriorSettings

IMPOSSIBLE: dict[Callable[..., Any], list[tuple[str, Any]]] = {
    maesn: [*(("meta_batch_size", 0), ("outer_batches", 0), ("inner_updates", -1))],
    rl2: [
        *(("meta_batch_size", 0), ("trial_episodes", 0), ("discount", 1.5), ("gae_lambda", -0.5))
    ],
    pearl: [*(("meta_batch_size", 0), ("extra_batches", -1))],
    EncoderSettings: [("kl_weight", -1.0), ("hidden_sizes", (0,))],
    SoftActorCritic: [
        *(("discount", 1.5), ("learning_rate", 0.0), ("output_penalty", -1.0)),
        ("hidden_sizes", (0,)),
    ],
    varibad: [*(("trial_episodes", 0), ("discount", 1.5), ("gae_lambda", -1.0))],
    BeliefEncoderSettings: [("latent_size", 0), ("hidden_size", 0)],
    BeliefDecoderSettings: [("cells", (0, 2)), ("reward_std", 0.0)],
    BeliefInference: [("kl_weight", -1.0), ("prefixes", 0)],
    HyperBonus: [("novelty_weight", -1.0), ("last_iteration", 0)],
    CuriosityBonus: [
        *(("weight", -1.0), ("hidden_sizes", (0,)), ("updates", -1), ("samples", 0)),
        *(("batch_size", 0), ("pool_size", 0), ("pool_additions", 0), ("median_window", 0)),
        *(("prior_std", 0.0), ("likelihood_std", 0.0), ("likelihood_std", math.inf)),
        ("learning_rate", math.nan),
    ],
    GradientStep: [("step_size", math.inf), ("step_size", 0.0)],
    TrustRegionStep: [("curvature_stride", 0)],
    ProximalOuterStep: [("steps", 0), ("learning_rate", 0.0), ("clip", 1.0)],
    TrustRegionOuterStep: [("curvature_stride", 0), ("hessian_stride", 0)],
    ProximalStep: [("clip", 0.0), ("entropy_weight", -1.0)],
    GradientRule: [("step_scale", math.inf), ("full_steps", 0), ("start_std", 0.0)],
    ThenTrpo: [("after", -2)],
    SearchSettings: [
        *(("exploration", -1.0), ("draws", -1), ("draw_std", 0.0), ("length_scale", math.inf))
    ],
    PriorSettings: [
        *(("draws", -1), ("episodes", 0), ("spread", -1.0), ("seed", -1), ("simulations", 0))
    ],
    LatentContext: [
        *(("size", 0), ("kl_weight", -0.1), ("initial_spread", -1.0)),
        *(("kl_weight", math.nan), ("initial_spread", math.nan)),
    ],
    BiasContext: [("size", -1)],
    InnerStep: [("first_iteration", -1)],
    StepSchedule: [("factor", 0.0), ("factor", 1.5)],
    AdvantageEstimator: [
        *(("discount", -0.1), ("discount", 1.1), ("gae_lambda", -0.1), ("gae_lambda", 1.1))
    ],
    GaussianMLP: [("initial_std", math.nan)],
    CategoricalMLP: [("hidden_sizes", (0,))],
    AnnealedGaussianMLP: [("final_std", 0.0), ("final_std", 1.5), ("first_iteration", 300)],
    Recurrent: [
        *(("hidden_size", 0), ("encoder_sizes", (3, 0)), ("readout_sizes", (-1,))),
        ("initial_std", 0.0),
    ],
    RecurrentValue: [("hidden_size", 0), ("encoder_sizes", (3, 0)), ("readout_sizes", (-1,))],
    TrustRegion: [("max_kl", 0.0), ("backtrack_ratio", 0.0), ("backtrack_ratio", 1.0)],
    MinibatchDescent: [
        *(("learning_rate", 0.0), ("epochs", 0), ("minibatches", 0), ("max_gradient_norm", 0.0))
    ],
    RunSettings: [
        *(("iterations", -1), ("iterations", 2**31), ("seed", -1), ("seed", 2**32)),
        *(("episodes_per_task", 0), ("episodes_per_task", 2**31), ("checkpoint_every", 0)),
        *(("num_threads", -2), ("sparse_radius", 0.0), ("sparse_radius", math.nan)),
    ],
}


@pytest.mark.parametrize(
    ("make", "name", "value"),
    [(make, *setting) for make, settings in IMPOSSIBLE.items() for setting in settings],
)
def test_impossible_settings_are_refused_by_name(
    make: Callable[..., Any], name: str, value: Any
) -> None:
    with pytest.raises(ValueError, match=f"`{name}` .*must"):
        make(**{name: value})


def test_a_policy_without_memory_cannot_play_trials() -> None:
    with pytest.raises(ValueError, match="`trial_episodes` is 2"):
        rl2(policy=GaussianMLP())
