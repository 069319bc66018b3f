"""Limits on what is executed, and the bound on the latent."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runtime.robot import STEPS, contents, observations, play, towards

from maesn.runtime import Explorer, Safeguards


def executed(policy: Path, safeguards: Safeguards | None, steps: int = 60) -> Any:
    """One episode of the same explorer under different safeguards."""
    explorer = Explorer.load(policy, seed=0, safeguards=safeguards)
    explorer.begin_episode()
    for observation in observations(explorer, steps):
        explorer.act(3.0 * observation)
    return explorer.end_episode([0.0] * steps)


def test_controls_stay_within_the_limits_and_actions_are_recorded_as_they_were(
    policy: Path,
) -> None:
    free = executed(policy, None)
    held = executed(policy, Safeguards(lower=(-0.2, -2.0), upper=0.1))
    np.testing.assert_array_equal(held.actions, free.actions)
    np.testing.assert_array_equal(held.controls, np.clip(free.controls, [-0.2, -1.0], 0.1))
    assert (free.controls != held.controls).any()


def test_controls_change_no_faster_than_they_may(policy: Path) -> None:
    free = executed(policy, None)
    held = executed(policy, Safeguards(max_change=(0.1, 0.05), rest=0.3))
    change = np.diff(np.concatenate([np.full((1, 2), 0.3), held.controls]), axis=0)
    assert (abs(change) <= np.asarray([0.1, 0.05]) * (1 + 1e-12)).all()
    np.testing.assert_array_equal(held.actions, free.actions)
    # Each control is the one nearest to what was wanted.
    before = np.concatenate([np.full((1, 2), 0.3), held.controls[:-1]])
    wanted = np.clip(free.controls - before, [-0.1, -0.05], [0.1, 0.05])
    np.testing.assert_allclose(held.controls, before + wanted, atol=1e-15)


def test_the_next_episode_starts_at_rest_again(policy: Path) -> None:
    explorer = Explorer.load(
        policy, seed=0, safeguards=Safeguards(max_change=1e-3, rest=(0.5, 0.0))
    )
    for _ in range(2):
        explorer.begin_episode()
        first, *_ = [explorer.act(observation) for observation in observations(explorer, STEPS)]
        explorer.discard()
        assert (abs(first - np.asarray([0.5, 0.0])) <= 1e-3 + 1e-15).all()


def test_the_latent_s_norm_is_bounded(policy: Path) -> None:
    free, held = (
        Explorer.load(policy, seed=1, safeguards=Safeguards(max_latent_norm=bound))
        for bound in (None, 0.2)
    )
    infos = []
    for explorer in (free, held):
        play(explorer, 20, towards([2.0, 1.0]))
        infos.append(explorer.adapt())
    assert [info.shortened for info in infos] == [False, True]
    norm = np.linalg.norm(free.latent_mean)
    assert norm > 0.2
    np.testing.assert_allclose(held.latent_mean, 0.2 * free.latent_mean / norm, rtol=1e-12)
    np.testing.assert_array_equal(held.latent_std, free.latent_std)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"lower": 0.5, "upper": -0.5}, "leave no control"),
        *[({"lower": value}, "leave no control") for value in (3.0, math.inf)],
        ({"upper": -math.inf}, "leave no control"),
        ({"upper": (1.0, 1.0, 1.0)}, "`upper` must"),
        ({"max_change": 0.0}, "`max_change` must"),
        ({"max_change": 0.1, "rest": 7.0}, "`rest` must"),
        *[({"rest": value}, "`rest` must be finite") for value in (math.inf, (0.0, -math.inf))],
        ({"lower": math.nan}, "`lower` must"),
        ({"max_latent_norm": -1.0}, "`max_latent_norm` must"),
    ],
)
def test_senseless_safeguards_are_refused(
    policy: Path, fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Explorer.load(policy, safeguards=Safeguards(**fields))


def test_limits_may_be_arrays() -> None:
    limits = Safeguards(lower=np.asarray([-1.0, 0.0]), rest=np.float64(0.5))
    assert limits == Safeguards(lower=(-1.0, 0.0), rest=0.5)


@pytest.mark.filterwarnings("ignore:overflow encountered", "ignore:invalid value")
@pytest.mark.parametrize("number", ["offset", "scale", "std"])
def test_what_leaves_is_finite_or_refused(policy: Path, number: str) -> None:
    usual = Explorer.load(policy).exported
    huge = np.full(2, 1.7e308)
    free = {"lower": np.full(2, -np.inf), "upper": np.full(2, np.inf)}
    actuators = replace(usual.actuators, **free, **{} if number == "std" else {number: huge})
    std = huge if number == "std" else usual.policy.std
    exported = replace(usual, policy=replace(usual.policy, std=std), actuators=actuators)
    explorer = Explorer(exported, safeguards=Safeguards(max_change=1.7e308), seed=0)
    explorer.begin_episode()
    refused = []
    for observation in 1e30 * observations(explorer, 50):
        before = contents(explorer)
        try:
            assert np.isfinite(explorer.act(observation)).all()
        except ValueError as error:
            refused.append(str(error))
            assert contents(explorer) == before
    assert refused or number == "offset"
    assert all("must be finite, but the action" in message for message in refused)


def test_limits_may_be_numbers_of_numpy(policy: Path, tmp_path: Path) -> None:
    explorer = Explorer.load(policy, safeguards=Safeguards(max_latent_norm=np.float64(2)))
    explorer.save(tmp_path / "saved.npz")
    assert Explorer.load(tmp_path / "saved.npz").safeguards.max_latent_norm == 2.0
