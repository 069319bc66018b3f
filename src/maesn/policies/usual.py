"""The usual feed-forward policy for each kind of actions."""

from maesn.axes import ActionKind
from maesn.policies.base import AbstractPolicySettings
from maesn.policies.categorical_mlp import CategoricalMLP
from maesn.policies.gaussian_mlp import GaussianMLP

USUAL: dict[ActionKind, AbstractPolicySettings] = {
    "continuous": GaussianMLP(),
    "discrete": CategoricalMLP(),
}
