"""Which latents a search plays and deploys; on the robot and in the library alike."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.transitions import episodes_of
from runtime.robot import altered, contents, fast_learner, observations

from maesn.envs import Point
from maesn.evaluation.exporting import exported_policy, write_policy
from maesn.runtime import Explorer, Safeguards
from maesn.runtime.posterior import Reading
from maesn.runtime.return_model import ReturnPrior
from maesn.runtime.search import LatentSearch, SearchSettings
from maesn.search import SearchFastLearner

ARCHIVE_ALONE = SearchSettings(draws=0)
NOISE = 0.3


def peak(latents: np.ndarray, target: np.ndarray) -> np.ndarray:
    """What a latent returns: 10 at the target, 0 from a distance of 2 on."""
    distance = np.linalg.norm(latents - target, axis=-1)
    return np.asarray(10.0 * np.maximum(1.0 - distance / 2.0, 0.0))


def targets(number: int, seed: int) -> np.ndarray:
    angle = np.random.default_rng(seed).uniform(0, np.pi, number)
    return 3.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def peaks_prior(offset_std: float = 5.0, latents: int = 80) -> ReturnPrior:
    """Training tasks reward latents near a point on a half circle, which a search has to find."""
    archive = 2.5 * np.random.default_rng(0).standard_normal((latents, 2))
    excess = np.stack([peak(archive, target) for target in targets(60, seed=1)])
    return ReturnPrior(archive, excess, np.full(latents, NOISE**2), 4, -20.0, offset_std)


PRIOR = peaks_prior()


def search_of(prior: ReturnPrior = PRIOR, settings: SearchSettings = ARCHIVE_ALONE) -> LatentSearch:
    return LatentSearch.start(settings.model(prior), settings)


def searched(
    search: LatentSearch, target: np.ndarray, episodes: int, shift: float = 0.0, seed: int = 0
) -> tuple[LatentSearch, list[int]]:
    """Search in one task; every return is shifted by a constant."""
    generator, noise = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    chosen = []
    for _ in range(episodes):
        search, point = search.proposed(generator)
        played = peak(search.points[point], target) + shift + NOISE * noise.standard_normal()
        search = search.after([Reading(point, float(played))])
        chosen.append(point)
    return search, chosen


def deployed_values(settings: SearchSettings, episodes: int, number: int = 40) -> np.ndarray:
    """What the deployed latent is worth in unseen tasks."""
    found = []
    for index, target in enumerate(targets(number, seed=2)):
        search, _ = searched(search_of(settings=settings), target, episodes, -22.0, index)
        found.append(peak(search.points[search.best], target))
    return np.asarray(found)


@pytest.mark.parametrize("acquisition", ["ucb", "thompson"])
def test_the_latent_to_play_is_the_best_one_under_a_hypothesis_drawn_by_its_probability(
    acquisition: str,
) -> None:
    """After two returns about which the hypotheses disagree, in 1000 draws."""
    search = search_of(settings=replace(ARCHIVE_ALONE, acquisition=acquisition))
    search = search.after([Reading(67, -12.0), Reading(0, -14.0)])
    expected, number = np.zeros(len(PRIOR.latents)), 1000
    parts, weights = search.posterior.parts, search.posterior.weights
    for part, own in zip(parts, np.split(weights, [60, 120]), strict=True):
        bound = part.mean + 2.0 * part.std
        for mean, weight in zip(part.task_mean, own, strict=True):
            expected[np.argmax(mean if acquisition == "thompson" else bound)] += weight
    assert np.sort(expected)[-2] > 0.1
    generator = np.random.default_rng(0)
    points = [search.proposed(generator)[1] for _ in range(number)]
    found = np.bincount(points, minlength=len(expected)) / number
    assert (abs(found - expected) <= 4.5 * np.sqrt(expected * (1 - expected) / number)).all()
    assert search.best == np.argmax(search.posterior.mean)


@pytest.mark.parametrize("acquisition", ["ucb", "thompson"])
def test_a_search_finds_the_best_of_the_archive_in_unseen_tasks(acquisition: str) -> None:
    best = np.asarray([peak(PRIOR.latents, target).max() for target in targets(40, seed=2)])
    found = deployed_values(replace(ARCHIVE_ALONE, acquisition=acquisition), 12)
    assert (best - found).mean() < 0.05 * best.mean()
    assert deployed_values(ARCHIVE_ALONE, 0).mean() < 0.5 * best.mean()


@pytest.mark.long
def test_draws_around_the_best_latent_go_beyond_the_archive() -> None:
    alone = deployed_values(ARCHIVE_ALONE, 40)
    refined = deployed_values(replace(ARCHIVE_ALONE, draws=8), 40)
    gain = refined - alone
    assert gain.mean() > 3 * gain.std(ddof=1) / np.sqrt(len(gain))


def test_a_constant_that_is_added_to_every_return_of_a_task_changes_no_choice() -> None:
    """It might tell of the task, as the constant outside of the radius does, and must not."""
    search = search_of(peaks_prior(offset_std=1e5))
    target = targets(1, seed=3)[0]
    _, chosen = searched(search, target, 15, shift=-20.0)
    for shift in np.random.default_rng(4).uniform(-300, 300, 5):
        assert searched(search, target, 15, shift=shift)[1] == chosen


def test_posterior_intervals_cover_what_is_true() -> None:
    """More than nine in ten 90 % intervals do: most latents return the same in most tasks."""
    inside = []
    for index, target in enumerate(targets(40, seed=6)):
        search, _ = searched(search_of(), target, 5, -20.0, index)
        error = abs(search.posterior.mean - peak(PRIOR.latents, target))
        inside.append((error < 1.645 * search.posterior.std).mean())
    assert np.mean(inside) - 4 * np.std(inside, ddof=1) / np.sqrt(len(inside)) > 0.9


def test_an_interval_lies_between_the_levels_of_its_latent() -> None:
    levels = {"proposed_levels": (0.2, 0.7), "deployed_levels": (0.1, 0.6)}
    search, _ = searched(search_of(replace(PRIOR, **levels)), targets(1, seed=7)[0], 3)
    other = (search.best + 1) % len(search.points)
    for point, wanted in ((search.best, (0.1, 0.6)), (other, (0.2, 0.7))):
        ends = search.interval(point)
        places = [search.posterior.place(Reading(point, end)) for end in ends]
        assert places == pytest.approx(wanted, abs=1e-4)


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An exported policy that searches, with draws around the best."""
    return searcher(tmp_path_factory.mktemp("search") / "policy.npz", PRIOR)


def searcher(path: Path, prior: ReturnPrior) -> Path:
    levels = {"proposed_levels": (0.1, 0.9), "deployed_levels": (0.02, 0.8)}
    search = (replace(prior, **levels), SearchSettings())
    write_policy(path, exported_policy(fast_learner(), Point(), {}, search=search))
    return path


def episode(explorer: Explorer, value: float, steps: int = Point().horizon) -> None:
    for observation in observations(explorer, steps):
        explorer.act(observation)
    explorer.end_episode([value / steps] * steps)


def robot_searched(explorer: Explorer, target: np.ndarray, episodes: int) -> list[list[float]]:
    chosen = []
    for _ in range(episodes):
        z = explorer.begin_episode()
        episode(explorer, float(peak(z, target)) - 20.0)
        explorer.adapt()
        chosen.append(z.tolist())
    return chosen


def test_the_robot_chooses_as_the_library_does(policy: Path) -> None:
    explorer = Explorer.load(policy, seed=7)
    target = np.asarray([1.0, 2.5])
    exported = explorer.exported.search
    assert exported is not None
    search = LatentSearch.start(exported.model, exported.settings)
    generator = np.random.default_rng(7)
    for _ in range(12):
        z = explorer.begin_episode()
        search, point = search.proposed(generator)
        assert z.tolist() == search.points[point].tolist()
        value = float(peak(z, target)) - 20.0
        episode(explorer, value)
        explorer.adapt()
        total = float(np.full(Point().horizon, value / Point().horizon).sum())
        search = search.after([Reading(point, total)])
    assert explorer.begin_episode(explore=False).tolist() == search.points[search.best].tolist()
    np.testing.assert_array_equal(explorer.beliefs.mean, search.posterior.mean)
    np.testing.assert_array_equal(explorer.beliefs.std, search.posterior.std)
    assert explorer.beliefs.interval == search.interval(search.best)
    assert explorer.beliefs.familiar == search.posterior.familiar > 0.5


def test_four_robots_search_as_the_library_does_and_report_in_any_order(tmp_path: Path) -> None:
    """One robot plays for itself; between the reports of the others the search is saved."""
    target, horizon, path = np.asarray([1.0, 2.5]), Point().horizon, tmp_path / "robot.npz"
    steered, keys = fast_learner().latent, jax.random.split(jax.random.key(5), 1)
    exact = replace(PRIOR, noise=np.zeros_like(PRIOR.noise))  # so that it soon draws more latents
    explorer = Explorer.load(searcher(path, exact))
    exported = explorer.exported.search
    assert steered is not None
    assert exported is not None
    library = SearchFastLearner(steered, exported.model, exported.settings, at_once=4)
    state = library.init(keys)
    explorer._generator = np.random.default_rng(jax.random.key_data(keys[0]).tolist())
    order = np.random.default_rng(0)
    for number in range(6):
        latents = explorer.propose(4)
        search, chosen = state.searches[0], list(state.chosen[0])
        np.testing.assert_array_equal(latents, search.points[chosen])
        rewards = np.zeros((4, horizon), np.float32)
        rewards[:, 0] = peak(latents, target) - 20.0
        for robot in order.permutation(4):
            if robot == number % 4:
                assert explorer.begin_episode(z=latents[robot]).tolist() == latents[robot].tolist()
                for observation in observations(explorer, horizon):
                    explorer.act(observation)
                explorer.end_episode(rewards[robot])
            else:
                explorer.add_result(latents[robot], rewards[robot])
            explorer.save(path)
            explorer = Explorer.load(path)
        info = explorer.adapt()
        played = episodes_of(np.zeros((1, 4, horizon + 1, 2)), np.zeros((1, 4, horizon, 2)))
        state = library.update(state, replace(played, reward=jnp.asarray(rewards[None])))
        assert info.num_episodes == 4
        readings = explorer._state.search_for("a test").posterior.readings
        assert readings == state.searches[0].posterior.readings
    # What was loaded was computed again, which may move the last bits.
    found = explorer.beliefs.mean
    expected = state.searches[0].beliefs.mean[: len(found)]  # the library has proposed again
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    assert len(found) > len(PRIOR.latents)  # some were drawn around the best
    best = state.searches[0].points[state.searches[0].best]
    assert explorer.latent_mean.tolist() == best.tolist()


def test_a_result_may_come_late_or_never(policy: Path) -> None:
    explorer = Explorer.load(policy, seed=12)
    first, one_each = explorer.propose(3), np.full(Point().horizon, 1.0 / Point().horizon)
    explorer.add_result(first[1], -19.0 * one_each)
    assert explorer.adapt().num_episodes == 1
    explorer.propose(2)
    explorer.add_result(first[0], -18.0 * one_each)
    assert explorer.adapt().mean_return == pytest.approx(-18.0)
    with pytest.raises(RuntimeError, match="at least 1 finished"):
        explorer.adapt()


def test_results_that_make_no_sense_change_nothing(policy: Path) -> None:
    explorer = Explorer.load(policy, seed=13)
    z, before = explorer.propose(1)[0], contents(explorer)
    for rewards, said in (([], "shape"), ([np.nan], "finite"), ([1e101], "larger unit")):
        with pytest.raises(ValueError, match=said):
            explorer.add_result(z, rewards)
    with pytest.raises(ValueError, match="no point of this search"):
        explorer.add_result(z + 1.0, [0.0])
    with pytest.raises(ValueError, match="`count`"):
        explorer.propose(0)
    assert contents(explorer) == before
    explorer.begin_episode(z=z)
    with pytest.raises(RuntimeError, match="`propose` was called while an episode"):
        explorer.propose(2)


def test_a_robot_s_search_is_saved_in_the_middle_and_goes_on_exactly(
    policy: Path, tmp_path: Path
) -> None:
    target, path = np.asarray([-1.0, 2.5]), tmp_path / "robot.npz"
    whole = Explorer.load(policy, seed=8)
    first = robot_searched(whole, target, 14)
    parts = Explorer.load(policy, seed=8)
    second = robot_searched(parts, target, 9)
    parts.save(path)
    parts = Explorer.load(path)
    second += robot_searched(parts, target, 5)
    assert first == second
    assert contents(whole) == contents(parts)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("history", None, "`history` is missing"),
        ("history.added", np.zeros((2, 2)), "`SearchHistory.added` must have the shape"),
        ("history.added_after", [7], "`added_after` must count up to 1 readings"),
        ("history.readings", [{"point": 99, "episode_return": 0, "length": 1}], "`readings` name"),
        ("history.readings", [{"point": 0, "episode_return": math.inf, "length": 1}], "finite"),
        ("state.proposed", [99], "name points that are not there"),
        ("exported.search.horizon", 0, "`horizon` must be at least 1"),
        ("exported.search.prior.latents", np.zeros((80, 3)), "`ReturnPrior.latents` must have"),
        ("exported.search.prior.noise", np.zeros(()), "`exported.search.prior` is damaged"),
        ("exported.search.prior.proposed_levels", [0.5], "`exported.search.prior` is damaged"),
        ("exported.search.settings.draws", 0.5, "`exported.search.settings.draws` must be of type"),
    ],
)
def test_a_file_of_another_search_is_refused(
    policy: Path, tmp_path: Path, name: str, value: Any, message: str
) -> None:
    explorer = Explorer.load(policy, seed=9)
    robot_searched(explorer, np.asarray([0.5, 3.0]), 1)
    explorer.begin_episode(z=[0.5, 3.0])
    explorer.discard()
    explorer.propose(2)
    explorer.save(tmp_path / "saved.npz")
    assert Explorer.load(tmp_path / "saved.npz").beliefs.latents.shape == (81, 2)
    with pytest.raises(ValueError, match=message):
        Explorer.load(altered(tmp_path / "saved.npz", name, value))


def test_a_chosen_z_takes_part(policy: Path) -> None:
    explorer = Explorer.load(policy, seed=9)
    explorer.begin_episode(z=[0.5, 3.0])
    episode(explorer, -5.0)
    explorer.adapt()
    assert explorer.begin_episode(explore=False).tolist() == [0.5, 3.0]
    explorer.discard()
    assert explorer.latent_mean.tolist() == [0.5, 3.0]


def test_a_search_respects_the_bound_of_the_latent(policy: Path) -> None:
    explorer = Explorer.load(policy, seed=10, safeguards=Safeguards(max_latent_norm=1.5))
    for z in robot_searched(explorer, np.asarray([0.0, 3.0]), 5):
        assert np.linalg.norm(z) <= 1.5
    assert np.linalg.norm(explorer.begin_episode(explore=False)) <= 1.5
    # So does one that was saved in the middle of an episode.
    explorer.discard()
    explorer.begin_episode()
    explorer.save(policy.with_name("saved.npz"))
    explorer = Explorer.load(policy.with_name("saved.npz"))
    episode(explorer, -15.0)
    explorer.adapt()
    assert np.linalg.norm(explorer.latent_mean) <= 1.5


def test_the_bound_of_the_latent_holds_when_every_latent_within_it_is_known() -> None:
    far_first = np.argsort(-np.linalg.norm(PRIOR.latents, axis=1))
    latents, excess = PRIOR.latents[far_first], PRIOR.excess[:, far_first]
    exact = replace(PRIOR, latents=latents, excess=excess, noise=np.zeros(len(latents)))
    bound, generator, played = float(np.linalg.norm(latents[-3])), np.random.default_rng(0), []
    search = replace(search_of(exact), max_norm=bound)
    for _ in range(5):
        search, point = search.proposed(generator)
        search = search.after([Reading(point, -20.0)])
        played.append(point)
    assert {*played} == {77, 78, 79}


@pytest.mark.parametrize("value", [-200.0, 5.0])
def test_returns_that_no_prior_explains_are_noticed_once(
    policy: Path, tmp_path: Path, value: float
) -> None:
    explorer = Explorer.load(policy, seed=11)
    explorer.begin_episode()
    episode(explorer, -20.0)
    explorer.adapt()  # the usual reward: no warning, which would be an error in the tests
    explorer.begin_episode()
    episode(explorer, value)
    before = contents(explorer)
    said = f"returned {value:g} to {value:g}, but the prior of the search explains -3.* to "
    with pytest.raises(UserWarning, match=said):
        explorer.adapt()
    assert contents(explorer) == before
    with pytest.warns(UserWarning, match=said):
        explorer.adapt()
    explorer.save(tmp_path / "saved.npz")
    for later in (explorer, Explorer.load(tmp_path / "saved.npz")):
        later.begin_episode()
        episode(later, value)
        later.adapt()


def test_the_library_s_search_says_so_too(caplog: pytest.LogCaptureFixture) -> None:
    steered = fast_learner().latent
    assert steered is not None
    learner = SearchFastLearner(steered, ARCHIVE_ALONE.model(PRIOR), ARCHIVE_ALONE)
    state = learner.init(jax.random.split(jax.random.key(0), 3))
    for returns in ([-20.0, -19.0, -18.0], [-20.0, 5.0, -200.0], [5.0, 5.0, 5.0]):
        reward = np.zeros((3, 1, 4))
        reward[:, 0, 0] = returns
        seen, played = np.zeros((3, 1, 5, 2)), np.zeros((3, 1, 4, 2))
        given = jnp.asarray(reward, jnp.float32)
        state = learner.update(state, episodes_of(seen, played, reward=given))
    (record,) = caplog.records
    assert record.message.startswith("In 2 of 3 tasks, episodes returned 5 to 5, but the prior")


def test_beliefs_and_proposals_are_those_of_a_search(tmp_path: Path) -> None:
    path = tmp_path / "gradient.npz"
    write_policy(path, exported_policy(fast_learner(), Point(), {}))
    explorer = Explorer.load(path)
    with pytest.raises(RuntimeError, match="export with the rule `search`"):
        _ = explorer.beliefs
    with pytest.raises(RuntimeError, match="export with the rule `search`"):
        explorer.propose(4)
