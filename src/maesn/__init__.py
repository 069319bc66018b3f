"""Meta-reinforcement learning of structured exploration strategies, in JAX.

Every public name has one path, `maesn.<name>`, and is loaded when it is first used: importing this
package imports neither JAX nor MuJoCo, so that `maesn --help` answers at once and
`maesn.runtime` can live on a robot that has NumPy alone.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from maesn._version import __version__ as __version__

if TYPE_CHECKING:  # what a type checker and an editor see; the same names as in the table below
    from maesn.api import adapt as adapt
    from maesn.api import export as export
    from maesn.api import prior as prior
    from maesn.api import report as report
    from maesn.api import resume as resume
    from maesn.api import train as train
    from maesn.context import BiasContext as BiasContext
    from maesn.context import Latent as Latent
    from maesn.context import LatentContext as LatentContext
    from maesn.context import NoContext as NoContext
    from maesn.context import OracleContext as OracleContext
    from maesn.envs import FAMILIES as FAMILIES
    from maesn.envs import AbstractMujocoEnv as AbstractMujocoEnv
    from maesn.envs import AbstractPureEnv as AbstractPureEnv
    from maesn.envs import Reward as Reward
    from maesn.envs import TaskFamily as TaskFamily
    from maesn.envs import TaskSet as TaskSet
    from maesn.envs import find_family as find_family
    from maesn.envs.foreign import gymnasium_family as gymnasium_family
    from maesn.evaluation.evaluation import Evaluation as Evaluation
    from maesn.evaluation.film import render as render
    from maesn.experience.agent import Agents as Agents
    from maesn.experience.episodes import Collect as Collect
    from maesn.experience.episodes import Episodes as Episodes
    from maesn.inner.adaptation import Adaptation as Adaptation
    from maesn.inner.adaptation import InnerStep as InnerStep
    from maesn.inner.adaptation import StepSchedule as StepSchedule
    from maesn.inner.advantage import AdvantageEstimator as AdvantageEstimator
    from maesn.learners import METHODS as METHODS
    from maesn.learners import PRESETS as PRESETS
    from maesn.learners import SCRATCH as SCRATCH
    from maesn.learners import AbstractFastLearner as AbstractFastLearner
    from maesn.learners import AbstractMetaLearner as AbstractMetaLearner
    from maesn.learners import BonusFastLearner as BonusFastLearner
    from maesn.learners import BonusMetaLearner as BonusMetaLearner
    from maesn.learners import Capabilities as Capabilities
    from maesn.learners import FineTuning as FineTuning
    from maesn.learners import GradientMetaLearner as GradientMetaLearner
    from maesn.learners import PolicyGradient as PolicyGradient
    from maesn.learners import ProximalStep as ProximalStep
    from maesn.learners import RecurrentMetaLearner as RecurrentMetaLearner
    from maesn.learners import RecurrentValue as RecurrentValue
    from maesn.learners import SavedContexts as SavedContexts
    from maesn.learners import TrustRegionStep as TrustRegionStep
    from maesn.learners import latent_space as latent_space
    from maesn.learners import maesn as maesn
    from maesn.learners import maesn_theta as maesn_theta
    from maesn.learners import maml as maml
    from maesn.learners import maml_bias as maml_bias
    from maesn.learners import maml_bias_only as maml_bias_only
    from maesn.learners import oracle as oracle
    from maesn.learners import recommended as recommended
    from maesn.learners import rl2 as rl2
    from maesn.learners import rl2_trpo as rl2_trpo
    from maesn.learners.wrappers.curiosity import CuriosityBonus as CuriosityBonus
    from maesn.numerics import MinibatchDescent as MinibatchDescent
    from maesn.numerics.processes import Sharing as Sharing
    from maesn.numerics.trust_region import TrustRegion as TrustRegion
    from maesn.policies import CategoricalMLP as CategoricalMLP
    from maesn.policies import GaussianMLP as GaussianMLP
    from maesn.policies import Recurrent as Recurrent
    from maesn.rules import AbstractRule as AbstractRule
    from maesn.rules import AbstractWrapper as AbstractWrapper
    from maesn.rules import BestOfRule as BestOfRule
    from maesn.rules import CmaEsRule as CmaEsRule
    from maesn.rules import CrossEntropyRule as CrossEntropyRule
    from maesn.rules import GradientRule as GradientRule
    from maesn.rules import MemoryRule as MemoryRule
    from maesn.rules import NoAdaptation as NoAdaptation
    from maesn.rules import SearchRule as SearchRule
    from maesn.rules import ThenReinforce as ThenReinforce
    from maesn.rules import ThenTrpo as ThenTrpo
    from maesn.rules import Trained as Trained
    from maesn.rules import VimeBonus as VimeBonus
    from maesn.runs.config import RunSettings as RunSettings
    from maesn.runs.run import Run as Run
    from maesn.search.prior import PriorSettings as PriorSettings
    from maesn.storage import RunError as RunError
    from maesn.studies.comparison import compare as compare
    from maesn.studies.spec import EvaluationSpec as EvaluationSpec
    from maesn.studies.spec import FigureSpec as FigureSpec
    from maesn.studies.spec import LineSpec as LineSpec
    from maesn.studies.spec import RunSpec as RunSpec
    from maesn.studies.spec import ScratchSpec as ScratchSpec
    from maesn.studies.spec import StudySpec as StudySpec
    from maesn.studies.study import Study as Study
    from maesn.worlds import EpisodeError as EpisodeError
    from maesn.worlds import make_world as make_world
    from maesn.worlds.collector import Collector as Collector

# Module -> the names that it gives to the public surface. A name must not equal that of a module
# of this package: importing the module would silently put it in the name's place.
_PUBLIC: dict[str, tuple[str, ...]] = {
    "maesn.api": (
        "adapt",
        "export",
        "prior",
        "report",
        "resume",
        "train",
    ),
    "maesn.context": (
        "BiasContext",
        "Latent",
        "LatentContext",
        "NoContext",
        "OracleContext",
    ),
    "maesn.envs": (
        "AbstractMujocoEnv",
        "AbstractPureEnv",
        "FAMILIES",
        "Reward",
        "TaskFamily",
        "TaskSet",
        "find_family",
    ),
    "maesn.envs.foreign": ("gymnasium_family",),
    "maesn.evaluation.evaluation": ("Evaluation",),
    "maesn.evaluation.film": ("render",),
    "maesn.rules": (
        "AbstractRule",
        "AbstractWrapper",
        "BestOfRule",
        "CmaEsRule",
        "CrossEntropyRule",
        "GradientRule",
        "MemoryRule",
        "NoAdaptation",
        "SearchRule",
        "ThenReinforce",
        "ThenTrpo",
        "Trained",
        "VimeBonus",
    ),
    "maesn.experience.agent": ("Agents",),
    "maesn.experience.episodes": (
        "Collect",
        "Episodes",
    ),
    "maesn.inner.adaptation": (
        "Adaptation",
        "InnerStep",
        "StepSchedule",
    ),
    "maesn.inner.advantage": ("AdvantageEstimator",),
    "maesn.learners": (
        "AbstractFastLearner",
        "AbstractMetaLearner",
        "BonusFastLearner",
        "BonusMetaLearner",
        "Capabilities",
        "FineTuning",
        "GradientMetaLearner",
        "METHODS",
        "PRESETS",
        "PolicyGradient",
        "ProximalStep",
        "RecurrentMetaLearner",
        "RecurrentValue",
        "SCRATCH",
        "SavedContexts",
        "TrustRegionStep",
        "latent_space",
        "maesn",
        "maesn_theta",
        "maml",
        "maml_bias",
        "maml_bias_only",
        "oracle",
        "recommended",
        "rl2",
        "rl2_trpo",
    ),
    "maesn.learners.wrappers.curiosity": ("CuriosityBonus",),
    "maesn.numerics": ("MinibatchDescent",),
    "maesn.numerics.processes": ("Sharing",),
    "maesn.numerics.trust_region": ("TrustRegion",),
    "maesn.policies": (
        "CategoricalMLP",
        "GaussianMLP",
        "Recurrent",
    ),
    "maesn.runs.config": ("RunSettings",),
    "maesn.runs.run": ("Run",),
    "maesn.search.prior": ("PriorSettings",),
    "maesn.storage": ("RunError",),
    "maesn.studies.comparison": ("compare",),
    "maesn.studies.spec": (
        "EvaluationSpec",
        "FigureSpec",
        "LineSpec",
        "RunSpec",
        "ScratchSpec",
        "StudySpec",
    ),
    "maesn.studies.study": ("Study",),
    "maesn.worlds": (
        "EpisodeError",
        "make_world",
    ),
    "maesn.worlds.collector": ("Collector",),
}

_MODULE_OF = {name: module for module, names in _PUBLIC.items() for name in names}


def __getattr__(name: str) -> object:
    """Loads a public name at its first use (PEP 562) and keeps it."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module `maesn` has no attribute `{name}`; see `dir(maesn)`.")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})
