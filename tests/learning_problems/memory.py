"""A probe that recurrent methods solve, and no others."""

import jax
import numpy as np

from learning_problems.probes import HiddenSide
from maesn import ProximalStep, RecurrentValue
from maesn.envs import TaskSet
from maesn.evaluation.adapting import adapt
from maesn.learners import PRESETS, Problem
from maesn.numerics import MinibatchDescent
from maesn.policies import Recurrent
from maesn.worlds import make_world
from maesn.worlds.collector import Collector


def assert_a_probe_of_memory_is_solved(method: str) -> None:
    """The reward of a hidden side is 1 or 0 at an episode's last step; the agent sees nothing else.

    Without a state across episodes the second returns 1/2 at best, as the first does. With it, the
    reward of the first says where to go.
    """
    env = HiddenSide(horizon=1, reward_kind="sparse")
    tasks = TaskSet(np.float32([-1.0, 1.0] * 20))
    collect = Collector(make_world(env, tasks), 10)
    descent = MinibatchDescent(1e-2, epochs=4, minibatches=2)
    usual = {"rl2": {"policy_step": ProximalStep(descent=descent)}}
    learner = PRESETS[method](
        **usual.get(method, {}),
        policy=Recurrent(hidden_size=8, readout_sizes=(8,)),
        value=RecurrentValue((), 8, (8,), descent),
        meta_batch_size=40,
    )
    state = learner.init(
        jax.random.key(0), Problem(env.observation_size, env.action_size, len(tasks))
    )
    for iteration in range(80):
        state, _ = learner.step(jax.random.key(iteration), state, collect)
    outcome = adapt(learner.fast_learner(state), collect, episodes=10)
    first, second = outcome.curves.mean_return.mean(0)
    # 400 trials: the standard error of the first, a coin, is 0.025.
    assert abs(first - 0.5) < 0.1
    assert second > 0.9
    assert outcome.episodes_per_update == 1
    assert outcome.trial_episodes == 2
