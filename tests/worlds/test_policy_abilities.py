"""What a policy of a user's own may do in a collection: its distribution, its noise, its memory."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bernoulli_bandit import bandit
from jaxtyping import Array
from learning_problems.probes import HiddenEnd, hidden_end

from maesn.context import Nothing
from maesn.envs import FAMILIES, AnyEnv
from maesn.experience.agent import Agents
from maesn.numerics import DiagonalGaussian
from maesn.policies import AbstractPolicy, CategoricalMLP, GaussianMLP, PolicyInput
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

KEYS = jax.random.split(jax.random.key(0), 2)
SLOTS = jnp.arange(2)


@pytest.mark.parametrize(
    ("env", "settings"),
    [
        (FAMILIES["point"].make_env(horizon=5), GaussianMLP((8,))),
        (bandit.make_env(horizon=5), CategoricalMLP((8,))),
    ],
    ids=["continuous", "discrete"],
)
def test_agents_without_noise_take_the_most_probable_action(env: AnyEnv, settings: Any) -> None:
    family = FAMILIES["point"] if env.name == "point" else bandit
    policy = settings.init(jax.random.key(1), env.observation_size, env.action_size, 0)
    noisy = Agents(policy, Nothing(), shares_policy=True)
    collect = Collector(make_world(env, family.task_set("test")), 3)
    drawn, still = (collect(KEYS, one, SLOTS) for one in (noisy, replace(noisy, is_noisy=False)))
    np.testing.assert_array_equal(still.action, still.behaviour.mode())
    assert not np.array_equal(drawn.action, drawn.behaviour.mode())


class Diary(AbstractPolicy):
    """Counts its episodes, and keeps the last observation of each, and the action before it."""

    size: int = eqx.field(static=True)

    def __call__(self, policy_input: PolicyInput, z: Array, recurrent_state: Any) -> Any:
        mean = jnp.full(self.size, 0.5)
        return DiagonalGaussian(mean, jnp.zeros_like(mean)), recurrent_state

    def initial_recurrent_state(self) -> Any:
        return {"count": jnp.zeros(()), "seen": jnp.zeros(1), "done": jnp.zeros(self.size)}

    def after_episode(self, policy_input: PolicyInput, recurrent_state: Any) -> Any:
        return {
            "count": recurrent_state["count"] + 1.0,
            "seen": policy_input.observation,
            "done": policy_input.previous_action,
        }


def test_a_policy_learns_what_its_last_action_led_to() -> None:
    env = HiddenEnd()
    collect = Collector(make_world(env, hidden_end.task_set("test", size=4)), 3)
    cast = Agents(Diary(env.action_size), Nothing(), shares_policy=True)
    for count in (1, 2):
        episodes = collect(KEYS, cast, SLOTS, stage=count - 1)
        lengths = np.asarray(episodes.valid.sum(-1))
        assert (lengths < env.horizon).any(), "no episode ends early"
        kept = episodes.trial_end.recurrent_state
        at = lengths[..., None, None]
        last = np.take_along_axis(np.asarray(episodes.observation), at, axis=2)[:, :, 0]
        action = np.take_along_axis(np.asarray(episodes.action), at - 1, axis=2)[:, :, 0]
        np.testing.assert_array_equal(kept["count"], count)
        np.testing.assert_array_equal(kept["seen"], last)
        np.testing.assert_array_equal(kept["done"], action)
        cast = replace(cast, trial_state=episodes.trial_end)
