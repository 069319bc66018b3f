"""The methods that are meta-trained, as fillings of the slots of four learners.

Each function cites what it follows. Settings that are not named here are the defaults of the
slots, which follow the reference.
"""

from collections.abc import Callable
from typing import Any

from maesn.context import BiasContext, LatentContext, NoContext, OracleContext
from maesn.inner.adaptation import Adaptation, InnerStep, StepSchedule
from maesn.learners.fast import AbstractFastLearner
from maesn.learners.gradient.meta_learner import GradientMetaLearner
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.learners.meta import AbstractMetaLearner
from maesn.learners.pearl.meta_learner import PearlMetaLearner
from maesn.learners.policy_steps import TrustRegionStep
from maesn.learners.recurrent.meta_learner import RecurrentMetaLearner
from maesn.learners.scratch.fine_tuning import FineTuning
from maesn.learners.scratch.policy_gradient import PolicyImprovement
from maesn.learners.varibad.meta_learner import VaribadMetaLearner
from maesn.learners.wrappers.bonus import BonusFastLearner
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.numerics.trust_region import TrustRegion

# Inner step size of the weights: MAML's own experiments and every published descendant use 0.1.
POLICY_STEP = 0.1
# Step size of the weights in MAESN + theta when its second stage begins. With MAML's 0.1 the return
# after the update falls from -283 to -409 at once (results/settings.md).
THETA_STEP = 0.0
# Step size of MAML + bias, from the reference's run on the ant.
BIAS_STEP = 0.5
# For inner updates that run through the policy; results/curvature has the measurements.
HESSIAN_STRIDE = 4
# For a bias that is adapted alone; measured there as well.
BIAS_HESSIAN_STRIDE = 10
BIAS_CG_STEPS = 10


def maesn(**settings: Any) -> GradientMetaLearner:
    """MAESN: a latent per task, adapted alone, with learned step sizes (algorithm 1).

    Source: section "Meta-Learning Latent Variable Policies", equations (3) to (5). Reference
    settings for `wheeled`: initial step size 1, KL weight 0.1, two latent components.
    """
    return _fill(settings, context=LatentContext(), adaptation=Adaptation(context=InnerStep(1.0)))


def maesn_theta(**settings: Any) -> GradientMetaLearner:
    """MAESN with the optional update of the policy, equation (6).

    Stage-wise, as the paper found necessary: the first 150 meta-iterations leave the policy alone
    in the inner update. The paper gives no length of the stage; this is half of a run of 300.
    """
    policy = InnerStep(THETA_STEP, first_iteration=150)
    return _fill(
        settings,
        context=LatentContext(),
        adaptation=Adaptation(policy=policy, context=InnerStep(1.0)),
        outer=TrustRegionOuterStep(hessian_stride=HESSIAN_STRIDE),
    )


def maml(**settings: Any) -> GradientMetaLearner:
    """MAML: the policy's weights, with one fixed step size (section "Meta-Learning for RL")."""
    adaptation = Adaptation(policy=InnerStep(POLICY_STEP, learned=False))
    return _fill(
        settings,
        context=NoContext(),
        adaptation=adaptation,
        outer=TrustRegionOuterStep(hessian_stride=HESSIAN_STRIDE),
    )


def maml_bias(**settings: Any) -> GradientMetaLearner:
    """MAML + bias transformation + learned step sizes, adapting all parameters.

    Source: appendix "Ablation Study", variant (2). The reference's run of it, on the ant, began
    with step size 0.5 and had eight bias components.
    """
    adaptation = Adaptation(policy=InnerStep(BIAS_STEP), context=InnerStep(BIAS_STEP))
    return _fill(
        settings,
        context=BiasContext(),
        adaptation=adaptation,
        outer=TrustRegionOuterStep(hessian_stride=HESSIAN_STRIDE),
    )


def maml_bias_only(**settings: Any) -> GradientMetaLearner:
    """MAML + bias transformation + learned step sizes, adapting the bias alone.

    Source: appendix "Ablation Study", variant (3). The reference gives no step size for it; this
    is that of its runs which adapt all parameters.
    """
    adaptation = Adaptation(context=InnerStep(BIAS_STEP))
    return _fill(
        settings,
        context=BiasContext(),
        adaptation=adaptation,
        outer=TrustRegionOuterStep(
            TrustRegion(cg_steps=BIAS_CG_STEPS), hessian_stride=BIAS_HESSIAN_STRIDE
        ),
    )


def latent_space(**settings: Any) -> GradientMetaLearner:
    """LatentSpace: a latent per task, trained without an inner update (after Hausman et al.).

    It plays as many episodes per meta-iteration as MAESN and learns from all of them. (The
    reference collects the same number and throws half of them away.) In a new task the latents
    are adapted with the reference's steps 1, 1, 1, 1/2, 1/4, ...; KL weight 0.01. Of twice the
    episodes, the curvature takes as many steps as MAESN's.
    """
    return _fill(
        settings,
        context=LatentContext(kl_weight=0.01),
        adaptation=Adaptation(context=InnerStep(1.0, learned=False)),
        schedule=StepSchedule(full_steps=3),
        inner_updates=0,
        outer_batches=2,
        outer=TrustRegionOuterStep(curvature_stride=40),
    )


def oracle(**settings: Any) -> GradientMetaLearner:
    """The oracle: a policy that is given the task, the ceiling of all others.

    Updates change nothing: its curve in a new task is flat. In training it plays as
    many episodes per meta-iteration as MAESN and learns from all of them, by the same outer step,
    whose curvature takes as many steps as MAESN's.
    """
    return _fill(
        settings,
        context=OracleContext(),
        adaptation=Adaptation(),
        inner_updates=0,
        outer_batches=2,
        outer=TrustRegionOuterStep(curvature_stride=40),
    )


def _fill(settings: dict[str, Any], **defaults: Any) -> GradientMetaLearner:
    return GradientMetaLearner(**{**defaults, **settings})


def rl2(**settings: Any) -> RecurrentMetaLearner:
    """RL2: a recurrent policy, trained by PPO on trials of two episodes (Duan et al. 2016).

    The paper gives no settings for it. Clip 0.2, lambda 0.95, discount 0.99 and 64 units are those
    of garage's RL2; docs/explanation/methods/rl2.md says where the others are from.
    """
    return RecurrentMetaLearner(**settings)


def rl2_trpo(**settings: Any) -> RecurrentMetaLearner:
    """RL2 with the step of its paper, TRPO, instead of PPO (Duan et al. 2016)."""
    return RecurrentMetaLearner(**{"policy_step": TrustRegionStep(), **settings})


def pearl(**settings: Any) -> PearlMetaLearner:
    """PEARL: a posterior over the task from its transitions, and off-policy actor-critic.

    Source: Rakelly et al. 2019. Settings are the defaults of the authors' code;
    docs/explanation/methods/pearl.md lists those of their point goals.
    """
    return PearlMetaLearner(**settings)


def varibad(**settings: Any) -> VaribadMetaLearner:
    """VariBAD: a recurrent belief about the task, acted on by PPO; with a bonus, HyperX.

    Source: Zintgraf et al. 2020 and 2021. The settings of the authors' code differ from task to
    task; docs/explanation/methods/varibad.md lists those of GridNavi and of point goals.
    """
    return VaribadMetaLearner(**settings)


def fine_tuned(
    learner: AbstractFastLearner[Any], improvement: PolicyImprovement, after: int
) -> AbstractFastLearner[Any]:
    """Return a learner whose policy's weights follow `improvement` after so many episodes."""
    # Inside of a bonus, so that the weights learn from the bonus as well.
    return learner.inside(lambda one: FineTuning(one, improvement, after))


def with_curiosity(
    learner: AbstractFastLearner[Any],
    curiosity: CuriosityBonus,
    observation_size: int,
    action_size: int,
) -> AbstractFastLearner[Any]:
    """Return a learner that also gets a bonus for what it finds out, as in VIME."""
    return BonusFastLearner(learner, curiosity, observation_size, action_size)


PRESETS: dict[str, Callable[..., AbstractMetaLearner[Any, Any]]] = {
    preset.__name__: preset
    for preset in (
        maesn,
        maesn_theta,
        maml,
        maml_bias,
        maml_bias_only,
        latent_space,
        rl2,
        rl2_trpo,
        pearl,
        varibad,
        oracle,
    )
}


def method_name(learner: AbstractMetaLearner[Any, Any]) -> str:
    """Return the name of the preset whose slots a learner fills, or that of its class."""
    names = [name for name, preset in PRESETS.items() if preset().slots() == learner.slots()]
    return names[0] if names else type(learner).__name__
