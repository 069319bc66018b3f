"""Policies: what maps an observation and a context to a distribution of actions."""

from maesn.policies.base import AbstractPolicy as AbstractPolicy
from maesn.policies.base import AbstractPolicySettings as AbstractPolicySettings
from maesn.policies.base import PolicyInput as PolicyInput
from maesn.policies.gaussian_mlp import GaussianMLP as GaussianMLP
from maesn.policies.gaussian_mlp import GaussianMLPPolicy as GaussianMLPPolicy
