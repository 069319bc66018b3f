"""Files: exact continuation, whole or not at all, and damaged ones are refused."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runtime.robot import altered, contents, observations, play, towards

from maesn.runtime import Explorer, Safeguards

SAFEGUARDS = Safeguards(lower=(-0.5, -0.4), max_change=0.3, max_latent_norm=0.7)


def in_the_middle(policy: Path) -> Explorer:
    """An explorer with an update behind it, finished episodes, and one running."""
    explorer = Explorer.load(policy, seed=11, safeguards=SAFEGUARDS)
    play(explorer, 6, towards([1.0, 0.0]))
    explorer.adapt()
    play(explorer, 2, towards([1.0, 0.0]), steps=5)
    play(explorer, 1, towards([1.0, 0.0], steps=3), steps=3)
    explorer.begin_episode()
    for observation in observations(explorer, 2):
        explorer.act(observation)
    return explorer


def go_on(explorer: Explorer) -> list[Any]:
    """All that an explorer shows from here to the next but one update."""
    shown: list[Any] = [explorer.act(observation) for observation in observations(explorer, 3)]
    shown.append(explorer.end_episode([0.5] * 5).latent)
    play(explorer, 3, towards([0.0, 1.0]))
    shown.append(explorer.adapt())
    play(explorer, 4, towards([0.0, 90.0]))
    shown.append(explorer.adapt())
    return [*map(np.asarray, shown), explorer.latent_mean, explorer.latent_std]


def assert_equal(first: list[Any], second: list[Any]) -> None:
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_loaded_explorer_goes_on_exactly(policy: Path, tmp_path: Path) -> None:
    explorer = in_the_middle(policy)
    before = contents(explorer)
    explorer.save(tmp_path / "saved.npz")
    loaded = Explorer.load(tmp_path / "saved.npz")
    assert contents(loaded) == contents(explorer) == before
    assert loaded.safeguards == SAFEGUARDS
    shown = go_on(explorer)
    assert_equal(go_on(loaded), shown)


@pytest.mark.parametrize("num_steps", [None, 0, 1])
def test_every_stage_survives(policy: Path, tmp_path: Path, num_steps: int | None) -> None:
    explorer = Explorer.load(policy, seed=12)
    if num_steps is not None:
        explorer.begin_episode()
        for observation in observations(explorer, num_steps):
            explorer.act(observation)
    explorer.save(tmp_path / "saved.npz")
    assert contents(Explorer.load(tmp_path / "saved.npz")) == contents(explorer)


def test_loading_may_change_seed_and_safeguards(policy: Path, tmp_path: Path) -> None:
    in_the_middle(policy).save(tmp_path / "saved.npz")
    others = Safeguards(upper=0.2)
    first, second, third = (
        Explorer.load(tmp_path / "saved.npz", seed=seed, safeguards=others) for seed in (1, 1, 2)
    )
    assert first.safeguards == others
    draws = []
    for explorer in (first, second, third):
        explorer.discard()
        draws.append(explorer.begin_episode().tolist())
    assert draws[0] == draws[1] != draws[2]


def test_a_new_task_without_a_seed_is_random(policy: Path) -> None:
    draws = {tuple(Explorer.load(policy).begin_episode()) for _ in range(3)}
    assert len(draws) == 3


def test_every_array_is_needed(policy: Path, tmp_path: Path) -> None:
    saved = tmp_path / "saved.npz"
    in_the_middle(policy).save(saved)
    with np.load(saved) as archive:
        names = [name for name in archive.files if name != "metadata"]
    for name in names:
        with pytest.raises(ValueError, match=f"`{name}` is missing"):
            Explorer.load(altered(saved, name, None))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("exported.policy.biases.1", np.zeros(5), r"`exported.policy` .*\(5,\)"),
        ("exported.policy.weights.0", np.zeros(()), "`exported.policy` is damaged"),
        ("exported.policy.std", np.full(2, 1j), "`exported.policy.std` must hold finite numbers"),
        ("exported.policy.weights.0", np.full((4, 16), 1e300), "must hold finite numbers"),
        ("exported.start.mean", np.zeros((2, 1)), r"`Latent.mean` must have the shape \(2,\)"),
        ("exported.start.mean", np.zeros(0), "`exported.start` is damaged"),
        ("exported.start.mean", np.asarray([0.0, np.nan]), "`exported.start.mean` must hold fin"),
        ("exported.actuators.lower", np.full(2, np.nan), "`exported.actuators.lower` must hold"),
        ("exported.sensors.lower", np.zeros(3), r"`Sensors.lower` must have the shape \(2,\)"),
        ("exported.rule.mean_step", np.asarray(["a", "b"]), "`exported.rule.mean_step` must hold"),
        ("state.latent.mean", np.zeros(3), "`state.latent` is damaged"),
        ("state.episodes.0.rewards", np.full(5, 1e200), "`rewards` must be at most 1e.100"),
        ("state.episodes.0.rewards", np.zeros(4), r"must have the shape \(4, 2\), but has \(5, 2"),
        ("state.episodes.0.latent", np.zeros(3), "`Episode.latent` must have"),
        ("state.running.latent", np.zeros(3), "`RunningEpisode.latent` must"),
        ("state.running.actions", np.zeros((0, 2)), "need at least one array"),
        ("metadata", np.array('{"format": "maesn-policy", "version": 2}'), "version must be 3"),
        ("metadata", np.array('{"format": "other"}'), "format must be 'maesn-policy'"),
        ("metadata", np.array("[1, 2]"), "format must be"),
        ("metadata", np.array("{"), "something else or damaged"),
        ("metadata", np.array('{"format": "maesn-policy", "version": 3}'), "entry `exported`"),
        # What stands in the metadata.
        *(("exported.rule.factor", x, "`exported.rule.factor` must") for x in (math.nan, 10**400)),
        ("exported.rule.factor", True, "`exported.rule.factor` must be of type float"),
        ("exported.rule.discount", 2, "`discount` must"),
        ("exported.rule.ridge", math.inf, "`ridge` must"),
        ("exported.rule.full_steps", 0, "`full_steps` must"),
        ("exported.start_update", 10**400, "`exported.start_update` must be of type int"),
        ("exported.policy.weights", [], "`exported.policy` is damaged"),
        ("exported.actuators.names", ["a"], r"`Actuators.names` must have the shape \(2,\)"),
        ("exported.is_noisy", {"explore": True}, "`is_noisy` must be stated for"),
        ("exported.more", 1, "`exported` must have no entries but"),
        ("state.running.purpose", "rest", "`state.running.purpose` must be of type"),
        ("safeguards.lower", "low", "`safeguards.lower` must be of type float"),
        ("random_state.state", 3, "`random_state` is damaged"),
        ("random_state", None, "`state` and `random_state` belong together"),
    ],
)
def test_senseless_entries_are_refused(
    policy: Path, tmp_path: Path, name: str, value: Any, message: str
) -> None:
    explorer, saved = in_the_middle(policy), tmp_path / "saved.npz"
    explorer.save(saved)
    with pytest.raises(ValueError, match=message):
        Explorer.load(altered(saved, name, value))
