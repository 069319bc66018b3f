"""What a recurrent policy receives at each step, and how its state goes on."""

import jax.numpy as jnp
import numpy as np
import pytest
from carts import MOTOR, CartTask, cart_on
from learning_problems.probes import HiddenEnd
from playing import agents, keys

from maesn.axes import RecurrentState
from maesn.envs import Point, TaskSet, Wheeled, point, wheeled
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.experience.trial_state import TrialState
from maesn.numerics import DiagonalGaussian
from maesn.policies import AbstractPolicy, PolicyInput
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

HORIZON, EPISODES = 8, 3


class Witness(AbstractPolicy):
    """Writes its inputs into the distribution of its actions, and counts its steps."""

    def __call__(
        self, policy_input: PolicyInput, context: jnp.ndarray, carry: RecurrentState
    ) -> tuple[DiagonalGaussian, RecurrentState]:
        mean = jnp.stack([policy_input.previous_reward, policy_input.previous_action[0]])
        log_std = jnp.stack([0.01 * carry, policy_input.episode_start.astype(float)])
        return DiagonalGaussian(mean, log_std), carry + 1

    def initial_recurrent_state(self) -> RecurrentState:
        return jnp.zeros(())


# The last two reward the difference of two states, so they notice a wrong previous one.
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


def test_the_previous_reward_and_action_are_received(first: Episodes) -> None:
    received = np.asarray(first.behaviour.mean)
    rewards = shifted(np.asarray(first.reward))
    np.testing.assert_allclose(received[..., 0], rewards, rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(received[..., 1], shifted(np.asarray(first.action[..., 0])))


def test_the_state_goes_from_step_to_step(first: Episodes) -> None:
    counts = np.broadcast_to(np.arange(HORIZON), (2, EPISODES, HORIZON))
    np.testing.assert_allclose(first.behaviour.log_std[..., 0], 0.01 * counts, rtol=1e-6)
    np.testing.assert_array_equal(hidden(first), np.full((2, EPISODES), HORIZON))


def test_the_state_goes_from_episode_to_episode_if_agents_have_it(
    collect: Collector, first: Episodes
) -> None:
    second = collect(keys(2, 1), witnesses(collect, first.trial_end), jnp.array([0, 1]))
    counts = np.broadcast_to(np.arange(HORIZON, 2 * HORIZON), (2, EPISODES, HORIZON))
    np.testing.assert_allclose(second.behaviour.log_std[..., 0], 0.01 * counts, rtol=1e-6)
    np.testing.assert_array_equal(hidden(second), np.full((2, EPISODES), 2 * HORIZON))
    # The next episode begins with the last action and reward, and with the mark of a start.
    received = np.asarray(second.behaviour.mean[:, :, 0])
    np.testing.assert_allclose(received[..., 0], first.reward[..., -1], rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(received[..., 1], first.action[..., -1, 0])
    np.testing.assert_array_equal(second.behaviour.log_std[:, :, 0, 1], np.ones((2, EPISODES)))


def test_what_is_recorded_is_what_the_policy_received(collect: Collector, first: Episodes) -> None:
    """Replaying the inputs gives the distributions that were played, also in the next episode."""
    second = collect(keys(2, 1), witnesses(collect, first.trial_end), jnp.array([0, 1]))
    for episodes in (first, second):
        inputs = episodes.policy_inputs()
        received = np.stack([inputs.previous_reward, inputs.previous_action[..., 0]], axis=-1)
        np.testing.assert_allclose(received, episodes.behaviour.mean, rtol=1e-5, atol=1e-7)
        np.testing.assert_array_equal(inputs.episode_start, episodes.behaviour.log_std[..., 1])


def test_steps_after_the_end_leave_nothing_behind() -> None:
    """Episodes of 3 and 5 steps: state, action and reward are those of the last step alive."""
    lifetimes = np.float32([3, 5])
    world = make_world(HiddenEnd(horizon=HORIZON, action_size=2), TaskSet(lifetimes))
    collect = Collector(world, EPISODES)
    episodes = collect(keys(2), witnesses(collect), jnp.array([0, 1]))
    assert np.isnan(np.asarray(episodes.reward)).any()
    end = episodes.trial_end
    assert end is not None
    steps = lifetimes.astype(int)
    np.testing.assert_array_equal(end.recurrent_state, np.tile(steps[:, None], (1, EPISODES)))
    np.testing.assert_array_equal(end.reward, np.ones((2, EPISODES)))
    for slot, last in enumerate(steps - 1):
        np.testing.assert_array_equal(end.action[slot], episodes.action[slot, :, last])


def hidden(episodes: Episodes) -> np.ndarray:
    assert episodes.trial_end is not None
    return np.asarray(episodes.trial_end.recurrent_state)
