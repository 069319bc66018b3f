"""Learners: what improves inside a task, and what learns to, across tasks."""

from maesn.learners.base import AbstractFastLearner as AbstractFastLearner
from maesn.learners.base import AbstractMetaLearner as AbstractMetaLearner
from maesn.learners.fast import GradientFastLearner as GradientFastLearner
from maesn.learners.fast import GradientFastState as GradientFastState
from maesn.learners.gradient import GradientMetaLearner as GradientMetaLearner
from maesn.learners.gradient import GradientState as GradientState
from maesn.learners.info import GradientInfo as GradientInfo
from maesn.learners.presets import PRESETS as PRESETS
from maesn.learners.presets import latent_space as latent_space
from maesn.learners.presets import maesn as maesn
from maesn.learners.presets import maesn_theta as maesn_theta
from maesn.learners.presets import maml as maml
from maesn.learners.presets import maml_bias as maml_bias
from maesn.learners.presets import maml_bias_only as maml_bias_only
from maesn.learners.presets import method_name as method_name
