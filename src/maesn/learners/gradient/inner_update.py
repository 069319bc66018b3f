"""The two halves of an inner update in meta-training, on all devices that share the tasks.

Arguments and results have a row for each task slot of this process.
"""

from dataclasses import replace
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
    _, advantages = over_tasks(_estimate, estimator, episodes)
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
    agents_shared, agents_rows = agents.parts()
    shared = adaptation, context, sizes, agents_shared
    _, adapted_rows = over_tasks(_adapt, shared, (agents_rows, episodes, advantages))
    return replace(Agents.of_parts(agents_shared, adapted_rows), is_noisy=agents.is_noisy)


# `over_tasks` runs these. All that they return has a row per task, so their shared result is None.
def _estimate(estimator: AdvantageEstimator, episodes: Episodes) -> tuple[None, Advantages]:
    return None, estimator.of_tasks(episodes)


def _adapt(shared: Any, rows: Any) -> tuple[None, Any]:
    adaptation, context, sizes, agents_shared = shared
    agents_rows, episodes, advantages = rows
    agents = Agents.of_parts(agents_shared, agents_rows)
    _, adapted_rows = adaptation(agents, sizes, context, episodes, advantages).parts()
    return None, adapted_rows
