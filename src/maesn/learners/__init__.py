"""Learners: what improves inside a task, and what learns to, across tasks."""

from maesn.learners.fast import AbstractFastLearner as AbstractFastLearner
from maesn.learners.fast import AbstractSettableLatent as AbstractSettableLatent
from maesn.learners.fast import Capabilities as Capabilities
from maesn.learners.fast import Purpose as Purpose
from maesn.learners.meta import AbstractMetaLearner as AbstractMetaLearner
from maesn.learners.meta import Problem as Problem
from maesn.learners.policy_steps import GradientStep as GradientStep
from maesn.learners.presets import PRESETS as PRESETS
from maesn.learners.presets import fine_tuned as fine_tuned
from maesn.learners.presets import method_name as method_name
from maesn.learners.presets import with_curiosity as with_curiosity
from maesn.learners.recommended import recommended as recommended
from maesn.learners.recommended import recommended_run as recommended_run
from maesn.learners.scratch.baselines import baselines as baselines
from maesn.learners.scratch.fine_tuning import LEAST_BATCH as LEAST_BATCH
from maesn.learners.scratch.policy_gradient import SCRATCH as SCRATCH
from maesn.learners.scratch.policy_gradient import TRPO as TRPO
from maesn.learners.scratch.policy_gradient import PolicyImprovement as PolicyImprovement
from maesn.learners.wrappers.curiosity import CuriosityBonus as CuriosityBonus
