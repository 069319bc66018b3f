"""A fast learner for the real world: acts, explores, adapts and saves on a robot.

    explorer = Explorer.load("policy.npz", seed=0)
    for _ in range(updates):
        for _ in range(episodes):
            explorer.begin_episode()
            ... send explorer.act(observation) to the actuators, step by step ...
            explorer.end_episode(rewards)
        explorer.adapt()

`policy.npz` comes from `maesn.export`. This package needs NumPy and the standard
library alone: no JAX, no simulator, and nothing of the rest of the library.
"""

from maesn.runtime.actuators import Actuators as Actuators
from maesn.runtime.episode import Episode as Episode
from maesn.runtime.explorer import Explorer as Explorer
from maesn.runtime.exported import ExportedLearner as ExportedLearner
from maesn.runtime.exported import ExportedPolicy as ExportedPolicy
from maesn.runtime.latent import Latent as Latent
from maesn.runtime.latent import LearningRule as LearningRule
from maesn.runtime.learning import AdaptationInfo as AdaptationInfo
from maesn.runtime.policy import GaussianPolicy as GaussianPolicy
from maesn.runtime.return_model import Moments as Moments
from maesn.runtime.return_model import moments as moments
from maesn.runtime.safeguards import Safeguards as Safeguards
from maesn.runtime.sensors import Sensors as Sensors
from maesn.runtime.state import ExplorerState as ExplorerState
from maesn.runtime.table import facts as facts
