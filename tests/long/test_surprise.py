"""Returns of new tasks surprise no search of a shipped policy; rewards in another unit do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import maesn
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import new_tasks
from maesn.experience.episodes import Episodes
from maesn.runs.run import Run
from maesn.search.learner import SearchFastLearner, SearchState
from maesn.worlds.collector import Collector

pytestmark = pytest.mark.long
TASKS, EPISODES = 40, 6


def surprised(name: str, scale: float) -> np.ndarray:
    """In which tasks the search is surprised after each episode, `[episode, task]`."""
    asked, found = Evaluation(rule=maesn.SearchRule(), episodes=EPISODES), []
    with new_tasks(Run.open(name), asked) as (world, learner):
        assert isinstance(learner, SearchFastLearner)
        collect, slots = Collector(world, 1), jnp.arange(TASKS)
        state: SearchState = learner.init(jax.random.split(jax.random.key(0), TASKS))
        for episode in range(EPISODES):
            keys = jax.random.split(jax.random.key(episode + 1), TASKS)
            played: Episodes = collect(keys, learner.agents(state), slots)
            scaled = played.__class__(**vars(played) | {"reward": scale * played.reward})
            state = learner.update(state, scaled)
            found.append([search.is_surprised for search in state.searches])
    return np.asarray(found)


@pytest.mark.parametrize("name", ["wheeled", "ant", "blockpush"])
def test_the_usual_rewards_surprise_nobody(name: str) -> None:
    assert not surprised(name, 1.0).any()


@pytest.mark.parametrize(("name", "scale"), [("wheeled", 0.1), ("ant", 0.1), ("blockpush", 10.0)])
def test_rewards_in_another_unit_surprise_at_once(name: str, scale: float) -> None:
    assert surprised(name, scale)[0].all()
