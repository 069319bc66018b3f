"""An inner update of meta-training: of the task slots of this process, on its devices."""

from typing import Any

from maesn.context import AbstractContextSettings
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.inner.adaptation import Adaptation, StepSizes
from maesn.inner.advantage import AdvantageEstimator, Advantages
from maesn.numerics.mesh import over_tasks


def estimate(estimator: AdvantageEstimator, episodes: Episodes) -> Advantages:
    """Return the advantages of every task, `[task, ...]`."""
    advantages: Advantages
    _, advantages = over_tasks(_estimated, estimator, episodes)
    return advantages


def adapt(
    adaptation: Adaptation,
    context: AbstractContextSettings[Any],
    agents: Agents,
    sizes: StepSizes,
    episodes: Episodes,
    advantages: Advantages,
) -> Agents:
    """Return the agents after one update; see `Adaptation`."""
    shared, own = agents.parts()
    settings = adaptation, context
    _, moved = over_tasks(_adapted, (settings, shared, sizes), (own, episodes, advantages))
    return Agents.of_parts(shared, moved)


def _estimated(estimator: AdvantageEstimator, episodes: Episodes) -> tuple[None, Advantages]:
    return None, estimator.of_tasks(episodes)


def _adapted(shared: Any, rows: Any) -> tuple[None, Any]:
    (adaptation, context), common, sizes = shared
    own, episodes, advantages = rows
    agents = Agents.of_parts(common, own)
    return None, adaptation(agents, sizes, context, episodes, advantages).parts()[1]
