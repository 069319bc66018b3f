"""The usual policy without memory for each kind of actions, and policies made to suit a kind."""

import dataclasses

from maesn.axes import ActionKind
from maesn.policies.base import AbstractPolicySettings
from maesn.policies.categorical_mlp import CategoricalMLP
from maesn.policies.gaussian_mlp import GaussianMLP
from maesn.policies.recurrent import Recurrent

USUAL: dict[ActionKind, AbstractPolicySettings] = {
    "continuous": GaussianMLP(),
    "discrete": CategoricalMLP(),
}


def suited(policy: AbstractPolicySettings, kind: ActionKind) -> AbstractPolicySettings:
    """Return a policy's settings for actions of a kind.

    Only what was not said otherwise is changed. A policy of choices stays one, and so does one
    with a standard deviation of its own, which choices do not have: whoever plays them where that
    does not fit refuses them by name.

    Args:
        policy: settings for actions of any kind.
        kind: of the actions that are needed.
    """
    if kind == "continuous" or not isinstance(policy, GaussianMLP | Recurrent):
        return policy
    if policy.initial_std != type(policy)().initial_std:
        return policy
    if isinstance(policy, Recurrent):
        return dataclasses.replace(policy, action_kind=kind)
    return CategoricalMLP(policy.hidden_sizes)
