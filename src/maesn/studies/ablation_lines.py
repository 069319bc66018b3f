"""The paper's last figure as named values: what each of its lines is."""

from collections.abc import Callable
from typing import Any, NamedTuple

from maesn.context import LatentContext
from maesn.inner.adaptation import Adaptation, InnerStep
from maesn.learners import (
    AbstractMetaLearner,
    maesn,
    maesn_theta,
    maml,
    maml_bias,
    maml_bias_only,
)
from maesn.learners.presets import POLICY_STEP, staged_adaptation

# Sparse radii of the last figure, in metres: that of the paper's text, and the one that the
# published figure appears to have been made with.
_RADII: dict[str, tuple[float, ...]] = {"wheeled": (0.8, 1.0)}


def ablation_radii(family: str) -> tuple[float | None, ...]:
    """Return the sparse radii of an ablation, in metres; None stands for the family's own."""
    return _RADII.get(family, (None,))


class Variation(NamedTuple):
    """One line of an ablation."""

    label: str
    make: Callable[..., AbstractMetaLearner[Any, Any]]
    """Takes settings of the learner, and the iterations that it will be trained for."""


def _variation(
    label: str, preset: Callable[..., AbstractMetaLearner[Any, Any]], **changed: Any
) -> Variation:
    return Variation(label, lambda iterations, **settings: preset(**{**changed, **settings}))


def _staged(iterations: int, **settings: Any) -> AbstractMetaLearner[Any, Any]:
    """Return MAESN with theta, of which the second half of the iterations adapts theta."""
    return maesn_theta(adaptation=staged_adaptation(iterations // 2), **settings)


ABLATION: dict[str, Variation] = {
    "maesn": _variation("MAESN", maesn),
    "maml": _variation("MAML", maml),
    "maml_bias": _variation("MAML + bias, all parameters", maml_bias),
    "maml_bias_only": _variation("MAML + bias, bias only", maml_bias_only),
    "maml_learned_steps": _variation(
        "MAML, learned steps", maml, adaptation=Adaptation(policy=InnerStep(POLICY_STEP))
    ),
    "maesn_fixed_steps": _variation(
        "MAESN, fixed steps", maesn, adaptation=Adaptation(context=InnerStep(1.0, learned=False))
    ),
    "maesn_without_kl": _variation(
        "MAESN, without KL", maesn, context=LatentContext(kl_weight=0.0)
    ),
    "maesn_theta": Variation("MAESN + θ, staged", _staged),
    "maesn_2_updates": _variation("MAESN, 2 inner updates", maesn, inner_updates=2),
    "maesn_3_updates": _variation("MAESN, 3 inner updates", maesn, inner_updates=3),
}
"""The appendix "Ablation Study": its four lines, and what each part of MAESN contributes."""
