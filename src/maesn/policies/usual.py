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

    Where something was set that has no meaning for that kind, as the standard deviation of a
    choice, they are returned as they are: whoever plays the policy refuses it by name.

    Args:
        policy: settings for actions of any kind.
        kind: of the actions that are needed.
    """
    if isinstance(policy, Recurrent):
        return dataclasses.replace(policy, action_kind=kind)
    if isinstance(policy, GaussianMLP) and kind == "discrete":
        same_size = CategoricalMLP(policy.hidden_sizes)
        return same_size if policy == GaussianMLP(policy.hidden_sizes) else policy
    return policy
