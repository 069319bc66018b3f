"""Episodes with z held at the mean or chosen by the caller: what is played, and what is learned."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from runtime.robot import constant, contents, observations, play, policy_file, towards

from maesn.envs import Point
from maesn.evaluation.exporting import Stated
from maesn.runtime import Explorer, Safeguards

OBSERVATION = np.asarray([0.1, -0.2])


def deploy(explorer: Explorer, reward: float = 100.0) -> np.ndarray:
    """Play a deployed episode and return its z."""
    z = explorer.begin_episode(explore=False)
    for observation in observations(explorer, 3):
        explorer.act(observation, explore=False)
    explorer.end_episode([reward] * 3)
    return z


def adapted(policy: Path) -> Explorer:
    """An explorer whose mean is no longer that of the prior."""
    explorer = Explorer.load(policy, seed=1)
    play(explorer, 10, towards([1.0, 0.5]))
    explorer.adapt()
    return explorer


def test_a_deployed_episode_is_played_at_the_mean(policy: Path) -> None:
    explorer = adapted(policy)
    z = explorer.begin_episode(explore=False)
    np.testing.assert_array_equal(z, explorer.latent_mean)
    assert abs(z).min() > 0
    mean = explorer.exported.policy.given(z).mean(OBSERVATION)
    control = explorer.act(OBSERVATION, explore=False)
    np.testing.assert_array_equal(control, explorer.control(mean))
    np.testing.assert_array_equal(explorer.end_episode([1.0]).latent, z)


def test_a_deployed_episode_is_not_learned_from(policy: Path) -> None:
    disturbed, undisturbed = adapted(policy), adapted(policy)
    for explorer in (disturbed, undisturbed):
        for number in range(4):
            if explorer is disturbed:
                deploy(explorer, reward=100.0 * number)
            play(explorer, 1, towards([1.0, 0.5]))
    assert len(disturbed.episodes) == len(undisturbed.episodes) == 4
    assert disturbed.adapt() == undisturbed.adapt()
    assert contents(disturbed) == contents(undisturbed)


def test_a_chosen_z_is_played_and_copied(policy: Path) -> None:
    explorer, chosen = Explorer.load(policy, seed=2), np.asarray([0.5, -2.0])
    z = explorer.begin_episode(z=chosen)
    chosen[:] = z[:] = 99.0
    mean = explorer.exported.policy.given(np.asarray([0.5, -2.0])).mean(OBSERVATION)
    control = explorer.act(OBSERVATION, explore=False)
    np.testing.assert_array_equal(control, explorer.control(mean))
    assert explorer.end_episode([1.0]).latent.tolist() == [0.5, -2.0]


def test_choosing_what_would_be_drawn_learns_the_same(policy: Path) -> None:
    drawn, chosen = Explorer.load(policy, seed=3), Explorer.load(policy, seed=3)
    play(drawn, 5, towards([1.0, 0.5]))
    for number, episode in enumerate(drawn.episodes):
        chosen.begin_episode(z=episode.latent)
        for observation in observations(chosen, len(episode.rewards), seed=number):
            chosen.act(observation)
        chosen.end_episode(episode.rewards)
    assert drawn.adapt() == chosen.adapt()
    np.testing.assert_array_equal(drawn.latent_mean, chosen.latent_mean)
    np.testing.assert_array_equal(drawn.latent_std, chosen.latent_std)


@pytest.mark.parametrize("begin", [{"explore": False}, {"z": [0.25, 0.5]}])
def test_such_an_episode_is_saved_and_goes_on(
    policy: Path, tmp_path: Path, begin: dict[str, Any]
) -> None:
    explorer = adapted(policy)
    explorer.begin_episode(**begin)
    explorer.act(OBSERVATION)
    explorer.save(tmp_path / "saved.npz")
    loaded = Explorer.load(tmp_path / "saved.npz")
    assert contents(loaded) == contents(explorer)
    for each in (explorer, loaded):
        each.act(OBSERVATION)
        each.end_episode([1.0, 2.0])
        play(each, 3, constant(2.0))
    assert len(loaded.episodes) == (3 if "explore" in begin else 4)
    assert loaded.adapt() == explorer.adapt()
    assert contents(loaded) == contents(explorer)


class Shifted(Point):
    """A point whose controls reach from -1 to 2 or, of the other actuator, to 3."""

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return jnp.clip(0.5 + 2.0 * action, -1.0, jnp.asarray([2.0, 3.0]))


def test_normalized_controls_reach_from_one_limit_to_the_other(tmp_path: Path) -> None:
    path = policy_file(tmp_path, Shifted())
    narrow = Safeguards(upper=1.5)  # it is the range of training that is normalised
    plain, scaled = (Explorer.load(path, seed=5, safeguards=narrow) for _ in range(2))
    for explorer in (plain, scaled):
        explorer.begin_episode()
    seen = 20.0 * observations(plain, 30)
    controls = np.stack([plain.act(observation) for observation in seen])
    answers = np.stack([scaled.act(observation, normalized=True) for observation in seen])
    for column, upper in enumerate((2.0, 3.0)):
        wanted = np.interp(controls[:, column], (-1.0, upper), (-1.0, 1.0))
        np.testing.assert_allclose(answers[:, column], wanted, atol=1e-7)
        assert 0 < answers[:, column].max() < 1.0
    # What is recorded, and what the rate limit counts from, stays in the actuators' units.
    np.testing.assert_array_equal(scaled.end_episode([0.0] * 30).controls, controls)


class OneSided(Point):
    """A point that is limited to the right alone."""

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return jnp.minimum(action, 1.0)


def test_actuators_without_limits_cannot_be_normalized(tmp_path: Path) -> None:
    path = policy_file(tmp_path, OneSided(), stated=Stated(lower=-np.inf))
    explorer = Explorer.load(path, seed=6)
    explorer.begin_episode()
    before = contents(explorer)
    with pytest.raises(ValueError, match=r"actuator 0 has the range -inf to 1\.0"):
        explorer.act(OBSERVATION, normalized=True)
    assert contents(explorer) == before
