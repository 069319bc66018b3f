"""Acting and adapting, and what an explorer says to calls that make no sense."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from runtime.robot import STEPS, constant, contents, observations, play, towards

from maesn.runtime import Explorer, ExplorerState, Latent

OBSERVATION = np.asarray([0.1, -0.2])


def test_z_and_actions_are_the_draws_that_the_seed_says(policy: Path) -> None:
    exported, stream = Explorer.load(policy).exported, np.random.default_rng(5)
    latent = Latent(np.asarray([1.0, -0.5]), np.asarray([0.3, -2.0]))
    explorer = Explorer(exported, ExplorerState(latent), seed=5)
    z = explorer.begin_episode()
    np.testing.assert_allclose(z, latent.mean + np.exp(latent.log_std) * stream.standard_normal(2))
    explorer.act(OBSERVATION)
    episode = explorer.end_episode([0.0])
    mean = explorer.exported.policy.given(z).mean(OBSERVATION)
    expected = mean + explorer.exported.policy.std * stream.standard_normal(2)
    np.testing.assert_array_equal(episode.actions, [expected])


def test_episodes_keep_what_was_seen_and_done(policy: Path) -> None:
    explorer = Explorer.load(policy, seed=3)
    z = explorer.begin_episode()
    seen = observations(explorer, 3)
    done = [explorer.act(observation) for observation in seen]
    episode = explorer.end_episode([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(episode.latent, z)
    np.testing.assert_array_equal(episode.observations, seen)
    np.testing.assert_array_equal(episode.controls, done)
    assert episode.rewards.tolist() == [1.0, 2.0, 3.0]
    assert explorer.episodes[0] is episode


def test_buffers_may_be_reused_and_answers_changed(policy: Path) -> None:
    explorer = Explorer.load(policy, seed=3)
    z, buffer = explorer.begin_episode(), np.asarray([0.5, 0.5])
    control = explorer.act(buffer)
    kept = control.copy()
    for array in (z, buffer, control, explorer.latent_mean, explorer.latent_std):
        array[:] = 99.0
    episode = explorer.end_episode([0.0])
    assert episode.observations.tolist() == [[0.5, 0.5]]
    np.testing.assert_array_equal(episode.controls, [kept])
    assert 99.0 not in [*episode.latent, *explorer.latent_mean, *explorer.latent_std]


def test_adapt_tells_what_it_did_and_forgets_the_episodes(policy: Path) -> None:
    explorer = Explorer.load(policy, seed=5)
    play(explorer, 4, constant(2.0))
    info = explorer.adapt()
    assert info.mean_return == pytest.approx(2.0 * STEPS)
    assert (info.num_episodes, info.shortened) == (4, False)
    assert (explorer.update, explorer.episodes) == (1, ())


def test_discarded_episodes_teach_nothing(policy: Path) -> None:
    explorer, undisturbed = Explorer.load(policy, seed=6), Explorer.load(policy, seed=6)
    for each in (explorer, undisturbed):
        play(each, 4, towards([1.0, 0.0]))
    explorer.begin_episode()
    explorer.act(OBSERVATION)
    explorer.discard()
    for each in (explorer, undisturbed):
        each.adapt()
    np.testing.assert_array_equal(explorer.latent_mean, undisturbed.latent_mean)


def begin(explorer: Explorer, steps: int) -> None:
    explorer.begin_episode()
    for observation in observations(explorer, steps):
        explorer.act(observation)


MISUSE: list[tuple[int | None, str, Callable[[Explorer], object]]] = [
    # steps of the running episode (None: none runs), what the message says, and the call
    (None, "call `begin_episode", lambda e: e.act(OBSERVATION)),
    (None, "call `begin_episode", lambda e: e.end_episode([1.0])),
    (None, "call `begin_episode", lambda e: e.discard()),
    (2, "episode of 2 steps is running", lambda e: e.begin_episode()),
    (2, "episode of 2 steps is running", lambda e: e.adapt()),
    (0, "at least one step", lambda e: e.end_episode([])),
    (2, r"shape \(2,\).*\(3,\)", lambda e: e.act(np.zeros(3))),
    (2, "`observation` must hold 2 numbers", lambda e: e.act(["a", "b"])),
    (2, "component 1 is nan", lambda e: e.act([0.0, np.nan])),
    (2, "component 0 is inf", lambda e: e.act([np.inf, 0.0])),
    (2, "one for each call of `act`", lambda e: e.end_episode([1.0])),
    (2, "one for each call of `act`", lambda e: e.end_episode([1.0] * 3)),
    (2, "component 1 is nan", lambda e: e.end_episode([1.0, np.nan])),
    (2, "at most 1e.100 in size", lambda e: e.end_episode([1.0, -1e200])),
    (None, r"shape \(2,\).*\(3,\)", lambda e: e.begin_episode(z=np.zeros(3))),
    (None, "`z` must be finite", lambda e: e.begin_episode(z=[0.0, np.nan])),
    (None, "at the latent's mean", lambda e: e.begin_episode(explore=False, z=[0.0, 0.0])),
    (2, "`action` must have shape", lambda e: e.control([1.0, 2.0, 3.0])),
]


@pytest.mark.parametrize(("steps", "message", "call"), MISUSE)
def test_misuse_is_refused_and_loses_nothing(
    policy: Path, steps: int | None, message: str, call: Callable[[Explorer], object]
) -> None:
    explorer = Explorer.load(policy, seed=7)
    play(explorer, 3, towards([1.0, 0.0]))
    if steps is not None:
        begin(explorer, steps)
    before = contents(explorer)
    with pytest.raises((RuntimeError, ValueError), match=message):
        call(explorer)
    assert contents(explorer) == before


@pytest.mark.filterwarnings("ignore:overflow encountered", "ignore:invalid value")
def test_an_observation_beyond_single_precision_is_refused(policy: Path) -> None:
    explorer = Explorer.load(policy, seed=7)
    begin(explorer, 1)
    before = contents(explorer)
    with pytest.raises(ValueError, match="so large that the policy's answer is"):
        explorer.act([1e39, -1e39])
    assert contents(explorer) == before


@pytest.mark.parametrize("num_episodes", [0, 1])
def test_adapt_needs_episodes_to_compare(policy: Path, num_episodes: int) -> None:
    explorer = Explorer.load(policy, seed=8)
    play(explorer, num_episodes, constant(1.0))
    before = contents(explorer)
    with pytest.raises(RuntimeError, match=f"at least 2 finished episodes.*got {num_episodes}"):
        explorer.adapt()
    assert contents(explorer) == before


def test_an_update_to_a_latent_that_draws_infinity_is_refused(policy: Path) -> None:
    explorer = Explorer.load(policy, seed=9)
    for number in range(4):
        explorer.begin_episode(z=[50.0 * (1 + number % 2), 0.0])  # steps like its square
        explorer.act(OBSERVATION)
        explorer.end_episode([float(number % 2)])
    before = contents(explorer)
    with pytest.raises(RuntimeError, match="not finite, or too large: the latent must have a mean"):
        explorer.adapt()
    assert contents(explorer) == before


@pytest.mark.parametrize(("mean", "log_std"), [(1e101, 0.0), (0.0, 800.0), (0.0, -800.0)])
def test_latents_that_nothing_can_be_drawn_from_are_refused(mean: float, log_std: float) -> None:
    with pytest.raises(ValueError, match="the latent must have a mean of at most 1e"):
        Latent(np.full(2, mean), np.full(2, log_std))
