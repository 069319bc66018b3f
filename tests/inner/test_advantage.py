"""Advantages against the reference: a linear baseline per task, and GAE."""

from dataclasses import asdict, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.prepared import EQUAL, UNEQUAL, make_problem, stack
from learning_problems.translation import advantages_of
from reference.advantage import AdvantageSettings, Episode, experience

from maesn.experience.episodes import Episodes
from maesn.inner.advantage import AdvantageEstimator, Advantages

REFERENCE, SHORT_SIGHTED = AdvantageSettings(), AdvantageSettings(0.9, 0.5, 0.1)


def batch_of(lengths: tuple[int, ...]) -> list[list[Episode]]:
    """Three tasks; some observations lie beyond the range that the features are clipped to."""
    batch = make_problem(0, lengths).batches(0)[:3]
    for episodes in batch:
        for episode in episodes:
            episode.observation[:, 2] *= 8
    assert max(np.abs(episode.observation).max() for episode in batch[0]) > 10
    return batch


def estimate(settings: AdvantageSettings, episodes: Episodes) -> Advantages:
    return advantages_of(AdvantageEstimator(**asdict(settings)), episodes)


def assert_equal_to_reference(
    actual: Advantages, batch: list[list[Episode]], settings: AdvantageSettings, atol: float
) -> None:
    for slot, episodes in enumerate(batch):
        expected = experience(episodes, settings)
        np.testing.assert_allclose(actual.episode[slot], expected.episode_advantages, atol=atol)
        for played, advantage in zip(actual.step[slot], expected.step_advantages, strict=True):
            steps = len(advantage)
            np.testing.assert_allclose(played[:steps], advantage, atol=atol)
            np.testing.assert_array_equal(played[steps:], 0.0)


@pytest.mark.parametrize("lengths", [EQUAL, UNEQUAL])
@pytest.mark.parametrize("settings", [REFERENCE, SHORT_SIGHTED])
@pytest.mark.usefixtures("x64")
def test_advantages(settings: AdvantageSettings, lengths: tuple[int, ...]) -> None:
    batch = batch_of(lengths)
    assert_equal_to_reference(estimate(settings, stack(batch)), batch, settings, atol=1e-9)


@pytest.mark.parametrize("lengths", [EQUAL, UNEQUAL])
def test_advantages_in_single_precision(lengths: tuple[int, ...]) -> None:
    batch = batch_of(lengths)
    assert_equal_to_reference(estimate(REFERENCE, stack(batch)), batch, REFERENCE, atol=2e-3)


@pytest.mark.parametrize("garbage", [1e30, np.nan, np.inf, -np.inf])
def test_garbage_after_the_end_changes_no_bit(garbage: float) -> None:
    batch = batch_of(UNEQUAL)
    clean, dirty = (estimate(REFERENCE, stack(batch, filler)) for filler in (0.0, garbage))
    np.testing.assert_array_equal(dirty.step, clean.step)
    np.testing.assert_array_equal(dirty.episode, clean.episode)


@pytest.mark.usefixtures("x64")
def test_one_episode_alone_teaches_its_steps() -> None:
    batch = [episodes[:1] for episodes in batch_of(EQUAL)]
    assert_equal_to_reference(estimate(REFERENCE, stack(batch)), batch, REFERENCE, atol=1e-9)


def test_equal_pay_teaches_nothing() -> None:
    # Here the library leaves the reference, which standardises what its baseline misses.
    episodes = stack(batch_of(EQUAL))
    equal = jnp.broadcast_to(episodes.reward[:, :1], episodes.reward.shape)
    advantages = estimate(REFERENCE, eqx.tree_at(lambda e: e.reward, episodes, equal))
    np.testing.assert_array_equal(advantages.step, 0.0)
    np.testing.assert_array_equal(advantages.episode, 0.0)
    # One reward of one episode is enough to learn from, and in its own task only.
    better = equal.at[0, 2, 3].add(1.0)
    advantages = estimate(REFERENCE, eqx.tree_at(lambda e: e.reward, episodes, better))
    np.testing.assert_allclose(jnp.std(advantages.step, axis=(1, 2)), [1, 0, 0], atol=1e-4)
    np.testing.assert_allclose(jnp.std(advantages.episode, axis=1), [1, 0, 0], atol=1e-4)


@pytest.mark.usefixtures("x64")
def test_equal_pay_drifts_as_in_the_reference_if_asked_to() -> None:
    batch = [
        [replace(episode, reward=episodes[0].reward) for episode in episodes]
        for episodes in batch_of(EQUAL)
    ]
    advantages = advantages_of(AdvantageEstimator(drifts=True), stack(batch))
    assert_equal_to_reference(advantages, batch, REFERENCE, atol=1e-9)
    np.testing.assert_allclose(jnp.std(advantages.step, axis=(1, 2)), 1.0, rtol=1e-5)
