"""The trials of `examples/rl2_with_stable_baselines3.py`, which need no PyTorch."""

import gymnasium
import numpy as np
from rl2_with_stable_baselines3 import Trials

EPISODES, HORIZON = 3, 20


def test_a_trial_is_some_episodes_of_one_task() -> None:
    env = Trials(gymnasium.make("maesn/SparsePoint-v0", tasks="test", reward="dense"), EPISODES)
    env.action_space.seed(0)
    observation, info = env.reset(seed=3, options={"task": 7})
    rewards, seen, over = [], [observation], False
    while not over:
        action = env.action_space.sample()
        observation, reward, _, over, info = env.step(action)
        assert info["task"] == 7
        assert env.observation_space.contains(observation)
        np.testing.assert_array_equal(observation[2:5], [*action, np.float32(reward)])
        rewards.append(reward)
        seen.append(observation)
    assert len(rewards) == EPISODES * HORIZON
    np.testing.assert_allclose(info["returns"], np.reshape(rewards, (EPISODES, HORIZON)).sum(1))
    # It begins at the origin, and so do the other episodes; the last state is that of its end.
    begins = np.array(seen)[:, 5]
    assert np.flatnonzero(begins).tolist() == [0, HORIZON, 2 * HORIZON]
    np.testing.assert_array_equal(np.array(seen)[[0, HORIZON, 2 * HORIZON], :2], 0.0)
    assert np.abs(seen[-1][:2]).max() > 0
