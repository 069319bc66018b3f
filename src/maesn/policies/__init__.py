"""Policies: what maps an observation and a context to a distribution of actions."""

from maesn.policies.annealed import AnnealedGaussianMLP as AnnealedGaussianMLP
from maesn.policies.base import AbstractPolicy as AbstractPolicy
from maesn.policies.base import AbstractPolicySettings as AbstractPolicySettings
from maesn.policies.base import PolicyInput as PolicyInput
from maesn.policies.feed_forward import USUAL as USUAL
from maesn.policies.feed_forward import CategoricalMLP as CategoricalMLP
from maesn.policies.feed_forward import GaussianMLP as GaussianMLP
from maesn.policies.feed_forward import GaussianMLPPolicy as GaussianMLPPolicy
from maesn.policies.recurrent import HyperRecurrent as HyperRecurrent
from maesn.policies.recurrent import Recurrent as Recurrent
from maesn.policies.recurrent import RecurrentPolicy as RecurrentPolicy
from maesn.policies.recurrent import input_features as input_features
from maesn.policies.recurrent import input_size as input_size
