"""Foreign environments: what is played is what a plain loop plays, and failures are named."""

from typing import Any

import jax
import numpy as np
import pytest
from playing import agents, assert_same, play
from strange_families import EPISODES, SEED, family_of, is_running, seeds, settable, walkers
from strangers import Chooser, Walker, draw_walks

from maesn.context import Nothing
from maesn.envs import TaskSet
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.foreign import pack_task
from maesn.policies import CategoricalMLP, Recurrent
from maesn.worlds import make_world


def plain_loop(task: np.ndarray, seed: int, actions: np.ndarray) -> dict[str, np.ndarray]:
    """One episode by Gymnasium's interface alone; the action space reaches from (-1, 0)."""
    env = Walker(task)
    seen, _ = env.reset(seed=int(seed))
    record: dict[str, list[Any]] = {"observation": [seen], "reward": [], "solved": []}
    terminated = truncated = False
    for action in actions:
        control = np.clip(action * [1, 0.25] + [0, 0.25], [-1, 0], [1, 0.5]).astype(np.float32)
        seen, reward, terminated, truncated, info = env.step(control)
        record["observation"].append(seen)
        record["reward"].append(reward)
        record["solved"].append(info["is_success"])
        if terminated or truncated:
            break
    return {name: np.array(values) for name, values in record.items()} | {
        "terminated": np.array(terminated)
    }


@pytest.fixture(scope="module")
def episodes() -> Episodes:
    return play(walkers.make_env(), tasks(), range(8), episodes=EPISODES, seed=SEED)


def tasks() -> TaskSet:
    drawn = draw_walks(np.random.default_rng(0), 8)
    drawn[:4, 2:] = [[2, 1], [3, 2], [4, 3], [5, 0]]
    return TaskSet(drawn)


def test_episodes_are_those_of_a_plain_loop(episodes: Episodes) -> None:
    for task, episode in np.ndindex(8, EPISODES):
        wanted = plain_loop(
            np.asarray(tasks()[task]),
            seeds(8)[task, episode],
            np.asarray(episodes.action)[task, episode],
        )
        length = len(wanted["reward"])
        played = jax.tree.map(lambda x: np.asarray(x[task, episode]), episodes)  # noqa: B023
        assert played.valid.sum() == length
        np.testing.assert_allclose(
            played.observation[: length + 1], wanted["observation"], atol=1e-6
        )
        np.testing.assert_allclose(played.reward[:length], wanted["reward"], atol=1e-6)
        np.testing.assert_array_equal(played.solved[:length], wanted["solved"])
        assert played.terminated == wanted["terminated"]


def test_neither_processes_nor_how_tasks_are_set_change_what_is_played(episodes: Episodes) -> None:
    settled = play(
        settable.make_env(), tasks(), range(8), episodes=EPISODES, seed=SEED, num_threads=3
    )
    assert_same(episodes, settled)
    # The same world again: its environments have played other tasks before.
    others = play(walkers.make_env(), tasks(), [5, 0, 3], episodes=EPISODES, seed=SEED)
    again = play(walkers.make_env(), tasks(), [5, 0, 3], episodes=EPISODES, seed=SEED)
    assert_same(others, again)


def test_a_policy_that_reads_rewards_sees_those_of_the_environment() -> None:
    """On sparse reward as well, far from the goal: the environment's own reward, as it is."""
    env = walkers.make_env(reward_kind="sparse")
    network = Recurrent(hidden_size=4, readout_sizes=(4,))
    policy = network.init(jax.random.key(0), env.observation_size, env.action_size, 0)
    cast = Agents(policy, Nothing(), shares_policy=True)
    episodes = play(env, tasks(), range(8), episodes=EPISODES, seed=SEED, cast=cast)
    assert np.any(~np.asarray(episodes.solved) & np.asarray(episodes.valid))
    np.testing.assert_array_equal(episodes.observed_reward, episodes.reward)


def test_discrete_actions_reach_the_environment_as_its_own() -> None:
    family = family_of(lambda choice, reward: Chooser(choice), control_period=1.0)
    choices = TaskSet(np.float32([[-1], [0], [1]]))
    env = family.make_env()
    policy = CategoricalMLP((8,)).init(jax.random.key(0), env.observation_size, env.action_size, 2)
    cast = Agents(policy, agents(env, 3).context, shares_policy=True)
    played = play(env, choices, [0, 1, 2], episodes=EPISODES, cast=cast)
    chosen = np.argmax(played.action, axis=-1) - 1
    assert len(np.unique(chosen)) == 3
    right = chosen == np.array([-1, 0, 1])[:, None, None]
    np.testing.assert_array_equal(played.reward, right)
    np.testing.assert_array_equal(played.solved, right)


def test_no_more_processes_are_started_than_there_are_episodes() -> None:
    two, one = (walkers.make_env().open_pool(n) for n in (2, 1))
    for episodes, processes in ((1, 1), (3, 2), (1, 2)):
        started = [pack_task(np.asarray(tasks()[0]))] * episodes, list(range(episodes))
        control = np.full((episodes, 2), 0.25, np.float32)
        assert_same(two.begin(*started), one.begin(*started))
        assert_same(two.step(control), one.step(control))
        assert (len(two.process_ids), len(one.process_ids)) == (processes, 1)
    two.close()
    one.close()


def test_a_world_that_is_forgotten_ends_its_processes() -> None:
    world = make_world(walkers.make_env(), tasks(), num_threads=2)
    world.stepper.begin(jax.numpy.arange(2, dtype=np.uint32), tasks()[:1])
    processes = world.stepper._pool.process_ids
    assert len(processes) == 2
    assert all(map(is_running, processes))
    del world
    assert not any(map(is_running, processes))
