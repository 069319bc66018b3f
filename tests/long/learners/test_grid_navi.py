"""RL2 with a hypernetwork on GridNavi, whose best possible behaviour is known."""

import jax

from maesn.envs.grid_navi import grid_navi
from maesn.evaluation.adapting import adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.learners import Problem, recommended
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

BEST = 37.21  # of four episodes, by `benchmarks/limits_grid_navi.py`


def test_recommended_settings_learn_to_search_and_to_remember() -> None:
    """60 of 200 meta-iterations. A policy that forgets would search four times: 16.0."""
    env, tasks = grid_navi.make_env(), grid_navi.task_set("training")
    learner = recommended("rl2", "grid_navi").for_actions("discrete")
    collect, key = Collector(make_world(env, tasks), 20), jax.random.key(0)
    state = learner.init(key, Problem(env.observation_size, env.action_size, collect.num_tasks))
    for iteration in range(60):
        state, _ = learner.step(jax.random.fold_in(key, iteration), state, collect)
    asked = Evaluation(episodes=60, episodes_per_update=20)
    returns = adapt(learner.fast_learner(state), collect, asked).curves.mean_return.mean(0)
    assert 0.8 * BEST < returns.sum() < 1.02 * BEST
    assert returns[0] < 5.0  # nobody knows the goal in the first episode
