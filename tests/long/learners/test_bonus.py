"""A curiosity bonus finds what a policy gradient alone does not."""

import jax
import jax.numpy as jnp
import numpy as np
from chain import chain
from playing import keys

from maesn.learners import SCRATCH
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.policies import GaussianMLP
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

TASKS = 3


def test_on_a_sparse_chain_vime_finds_the_reward_and_trpo_stands_still() -> None:
    # `benchmarks/vime_chain.py` is the long form, with more seeds.
    env, tasks = chain.make_env(reward_kind="sparse"), chain.task_set("test", size=TASKS)
    playing = Collector(make_world(env, tasks), 6)
    options = {"policy": GaussianMLP((16,))}
    eager = CuriosityBonus(updates=60, pool_additions=100, samples=4)
    found, stays = {}, {}
    for name, wrapped in (("trpo", {}), ("vime", {"curiosity": eager})):
        learner = SCRATCH[name](1, 1, **options, **wrapped)
        state = learner.init(keys(TASKS))
        for update in range(16):
            episodes = playing(keys(TASKS, update), learner.agents(state), jnp.arange(TASKS))
            state = learner.update(state, episodes)
        found[name] = np.asarray(episodes.reward > 0).any(axis=(1, 2)).tolist()
        policies = (learner.agents(s).policy for s in (learner.init(keys(TASKS)), state))
        leaves = zip(*map(jax.tree.leaves, policies), strict=True)
        stays[name] = all(np.array_equal(one, other) for one, other in leaves)
    assert stays == {"trpo": True, "vime": False}
    assert found == {"trpo": [False] * TASKS, "vime": [True] * TASKS}
