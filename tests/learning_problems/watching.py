"""A collector that keeps what it was asked and what was played, in episodes of unequal length."""

from typing import Any

import numpy as np

from learning_problems.probes import HiddenEnd
from maesn.envs import TaskSet
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

TASKS, EPISODES = 4, 3


class Watching(Collector):
    """Three episodes of 2 to 6 steps in each of four tasks; what follows their end is NaN."""

    def __init__(self, *lifetimes: int) -> None:
        tasks = TaskSet(np.float32(lifetimes or (2, 3, 5, 9)))
        super().__init__(make_world(HiddenEnd(horizon=6), tasks), EPISODES)
        self.agents: list[Agents] = []
        self.stages: list[int] = []
        self.played: list[Episodes] = []

    def __call__(self, keys: Any, agents: Agents, task_index: Any, stage: int = 0) -> Episodes:
        self.agents.append(agents)
        self.stages.append(stage)
        self.played.append(super().__call__(keys, agents, task_index, stage))
        return self.played[-1]
