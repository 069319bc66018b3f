"""What a policy with memory is told at each step, and what becomes of its memory."""

import jax.numpy as jnp
import numpy as np
import pytest
from carts import MOTOR, CartTask, cart_on
from playing import agents, assert_same, keys

from maesn.axes import RecurrentState
from maesn.envs import HiddenEnd, Point, TaskSet, Wheeled, point, wheeled
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.experience.trial_state import TrialState
from maesn.numerics import DiagonalGaussian
from maesn.policies import AbstractPolicy, PolicyInput
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

HORIZON, EPISODES = 8, 3


class Witness(AbstractPolicy):
    """Writes what it is told into the distribution of its actions, and counts its steps."""

    def __call__(
        self, policy_input: PolicyInput, context: jnp.ndarray, carry: RecurrentState
    ) -> tuple[DiagonalGaussian, RecurrentState]:
        mean = jnp.stack([policy_input.previous_reward, policy_input.previous_action[0]])
        log_std = jnp.stack([0.01 * carry, policy_input.episode_start.astype(float)])
        return DiagonalGaussian(mean, log_std), carry + 1

    def initial_recurrent_state(self) -> RecurrentState:
        return jnp.zeros(())


# The last two are paid for the difference of two states, so they notice a wrong previous one.
@pytest.fixture(scope="module", params=["point", "wheeled", "hidden_end", "cart"])
def collect(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Collector:
    cart = cart_on(tmp_path_factory.mktemp("model"), MOTOR)
    env, tasks = {
        "point": (Point(horizon=HORIZON), point.task_set("training")),
        "wheeled": (Wheeled(horizon=HORIZON), wheeled.task_set("training")),
        "hidden_end": (HiddenEnd(horizon=HORIZON, action_size=2), TaskSet(np.float32([20, 30]))),
        "cart": (
            cart(horizon=HORIZON, action_size=2, force=3.0),
            TaskSet(CartTask(np.float32([1, 2]), np.float32([1, 2]))),
        ),
    }[request.param]
    return Collector(make_world(env, tasks), EPISODES)


@pytest.fixture(scope="module")
def first(collect: Collector) -> Episodes:
    return collect(keys(2), witnesses(collect), jnp.array([0, 1]))


def witnesses(collect: Collector, trial_state: TrialState | None = None) -> Agents:
    context = agents(collect.world.env, 2).context
    return Agents(Witness(), context, shares_policy=True, trial_state=trial_state)


def shifted(values: np.ndarray) -> np.ndarray:
    """Each step's value one step later; zero at the start."""
    return np.concatenate([np.zeros_like(values[..., :1]), values[..., :-1]], axis=-1)


def test_the_previous_reward_and_action_are_told(first: Episodes) -> None:
    told = np.asarray(first.behaviour.mean)
    paid = shifted(np.asarray(first.reward))
    np.testing.assert_allclose(told[..., 0], paid, rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(told[..., 1], shifted(np.asarray(first.action[..., 0])))


def test_the_start_of_an_episode_is_told(first: Episodes) -> None:
    starts = np.arange(HORIZON) == 0
    expected = np.broadcast_to(starts, (2, EPISODES, HORIZON))
    np.testing.assert_array_equal(first.behaviour.log_std[..., 1], expected)


def test_memory_goes_from_step_to_step(first: Episodes) -> None:
    counts = np.broadcast_to(np.arange(HORIZON), (2, EPISODES, HORIZON))
    np.testing.assert_allclose(first.behaviour.log_std[..., 0], 0.01 * counts, rtol=1e-6)
    np.testing.assert_array_equal(hidden(first), np.full((2, EPISODES), HORIZON))


def test_memory_goes_from_episode_to_episode_if_it_is_passed_on(
    collect: Collector, first: Episodes
) -> None:
    second = collect(keys(2, 1), witnesses(collect, first.trial_end), jnp.array([0, 1]))
    counts = np.broadcast_to(np.arange(HORIZON, 2 * HORIZON), (2, EPISODES, HORIZON))
    np.testing.assert_allclose(second.behaviour.log_std[..., 0], 0.01 * counts, rtol=1e-6)
    np.testing.assert_array_equal(hidden(second), np.full((2, EPISODES), 2 * HORIZON))
    # What was done and paid last is told at the start of the next episode, and that it starts.
    told = np.asarray(second.behaviour.mean[:, :, 0])
    np.testing.assert_allclose(told[..., 0], first.reward[..., -1], rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(told[..., 1], first.action[..., -1, 0])
    np.testing.assert_array_equal(second.behaviour.log_std[:, :, 0, 1], np.ones((2, EPISODES)))


def test_memory_starts_afresh_otherwise(collect: Collector, first: Episodes) -> None:
    again = collect(keys(2), witnesses(collect), jnp.array([0, 1]))
    assert_same(again.trial_end, first.trial_end)


def test_what_is_recorded_is_what_the_policy_was_told(collect: Collector, first: Episodes) -> None:
    """Replaying the inputs gives the distributions that were played, also in the next episode."""
    second = collect(keys(2, 1), witnesses(collect, first.trial_end), jnp.array([0, 1]))
    for episodes in (first, second):
        inputs = episodes.policy_inputs()
        told = np.stack([inputs.previous_reward, inputs.previous_action[..., 0]], axis=-1)
        np.testing.assert_allclose(told, episodes.behaviour.mean, rtol=1e-5, atol=1e-7)
        np.testing.assert_array_equal(inputs.episode_start, episodes.behaviour.log_std[..., 1])


def test_a_dead_episode_is_not_remembered() -> None:
    """Episodes of 3 and 5 steps: memory, action and reward are those of the last step alive."""
    lifetimes = np.float32([3, 5])
    world = make_world(HiddenEnd(horizon=HORIZON, action_size=2), TaskSet(lifetimes))
    collect = Collector(world, EPISODES)
    episodes = collect(keys(2), witnesses(collect), jnp.array([0, 1]))
    assert np.isnan(np.asarray(episodes.reward)).any()
    memory = episodes.trial_end
    assert memory is not None
    steps = lifetimes.astype(int)
    np.testing.assert_array_equal(memory.recurrent_state, np.tile(steps[:, None], (1, EPISODES)))
    np.testing.assert_array_equal(memory.reward, np.ones((2, EPISODES)))
    for slot, last in enumerate(steps - 1):
        np.testing.assert_array_equal(memory.action[slot], episodes.action[slot, :, last])


def hidden(episodes: Episodes) -> np.ndarray:
    assert episodes.trial_end is not None
    return np.asarray(episodes.trial_end.recurrent_state)
