"""What is possible in the families whose best behaviour can be computed."""

import itertools
from typing import Any

import limits_grid_navi as grid_navi
import limits_search as search
import limits_sparse_point as sparse_point
import limits_walking as walking
import numpy as np
import pytest


def by_enumeration(size: int, steps: int, episodes: int) -> float:
    """Best mean return of a trial over all goals: every sequence of moves until the goal is met."""
    goals = [(x, y) for x in range(size) for y in range(size) if max(x, y) > 1]
    straight = {goal: sum(goal) for goal in goals}

    def episode(met: Any) -> Any:
        """Return of an episode whose goal is met in a step, counted from 1."""
        return -0.1 * (met - 1) + (steps + 1 - met)

    choices = np.array([(0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)])
    which = np.indices((5,) * (steps * episodes)).reshape(steps * episodes, -1)  # [move, sequence]
    cells, here = [], np.zeros((which.shape[1], 2), int)
    for number, chosen in enumerate(which):
        here = np.clip((0 if number % steps == 0 else here) + choices[chosen], 0, size - 1)
        cells.append(here)
    total = np.zeros(which.shape[1])
    for goal in goals:
        met = np.stack([(cell == goal).all(-1) for cell in cells])
        before, step = np.divmod(met.argmax(0), steps)
        later = (episodes - before - 1) * episode(straight[goal])
        found = -0.1 * steps * before + episode(step + 1) + later
        total += np.where(met.any(0), found, -0.1 * steps * episodes)
    return float(total.max() / len(goals))


@pytest.mark.parametrize(("steps", "episodes"), [(4, 1), (7, 1), (4, 2)])
def test_the_best_searcher_on_a_small_grid_is_that_of_enumeration(
    steps: int, episodes: int
) -> None:
    found = grid_navi.navi_limits(grid_navi.make_grid(3, steps, episodes))
    np.testing.assert_allclose(found.below.sum(), by_enumeration(3, steps, episodes))


def test_the_limits_of_the_paper_s_grid() -> None:
    grid = grid_navi.make_grid()
    found = grid_navi.navi_limits(grid)
    # Of 21 goals at distance D: -0.1 (D - 1) + 16 - D each.
    distance = np.array([x + y for x in range(5) for y in range(5) if max(x, y) > 1])
    oracle = (16 - distance - 0.1 * (distance - 1)).mean()
    np.testing.assert_allclose(found.oracle, oracle)
    assert round(oracle, 2) == 11.07
    # Fourteen goals in steps 2 to 15 is the most that an episode can see: the others lose 1.5. And
    # the seven that are left lie on one straight way.
    first = (sum(16 - s - 0.1 * (s - 1) for s in range(2, 16)) - 7 * 1.5) / 21
    np.testing.assert_allclose(found.below, [first, oracle, oracle, oracle])


def test_the_oracle_of_the_sparse_point() -> None:
    point = sparse_point.Point(0.2, 20, 1)
    rewards = sparse_point.oracle_rewards(point)
    assert rewards.shape == (20, sparse_point.NUM_ANGLES)
    # A goal straight ahead, near (0, 1), is 0.2 away after 8 steps and reached after 10.
    ahead = rewards[:, sparse_point.NUM_ANGLES // 2]
    np.testing.assert_allclose(ahead[:7], 0.0)
    np.testing.assert_allclose(ahead[8:], [0.9, *[1.0] * 11], atol=0.01)
    np.testing.assert_allclose(rewards.sum(0).mean(), 13.38, atol=0.02)
    for variant, expected in (("varibad", 93.38), ("metacure", 26.06)):
        settings = sparse_point.PROTOCOLS[variant]
        other = sparse_point.Point(settings["sparse_radius"], settings["horizon"], 1)
        np.testing.assert_allclose(
            sparse_point.oracle_rewards(other).sum(0).mean(), expected, atol=0.02
        )


@pytest.mark.parametrize("protocol", [(0.2, 20, 3), (0.3, 32, 2)])
def test_a_sweep_lies_below_what_no_searcher_exceeds(protocol: tuple[float, int, int]) -> None:
    point = sparse_point.Point(*protocol)
    oracle = sparse_point.oracle_rewards(point)
    above = sparse_point.most_in_first_episode(point, oracle)
    swept = sparse_point.sweep(point, 0.92, 0.2, 0.2)
    assert 1.0 < swept[0] < above < oracle.sum(0).mean()
    assert swept[-1] <= oracle.sum(0).mean() + 1e-9
    path = sparse_point.ring_path(point, 0.92, 0.2)
    steps = np.diff(path, axis=0, prepend=np.zeros((1, 2)))
    assert np.abs(steps).max() <= 0.1 + 1e-9


def test_no_list_of_latents_is_better_than_the_one_that_dynamic_programming_finds() -> None:
    """Every list, and every latent to deploy at the goals that the list does not reach."""
    stream, angles, latents = np.random.default_rng(0), 9, 5
    for _ in range(50):
        returns, reaches = stream.uniform(size=(angles, latents)), np.zeros((angles, latents), bool)
        for latent in range(latents):
            first, last = sorted(stream.integers(0, angles + 1, 2))
            reaches[first:last, latent] = True
        limit = search.best_lists(returns, reaches, (1, 2, 3))
        for count, found in zip((1, 2, 3), limit.searcher, strict=True):
            lists = itertools.combinations_with_replacement(range(latents), count)
            known = [reaches[:, list(chosen)].any(axis=1) for chosen in lists]
            best = [returns.max(axis=1)[k].sum() + returns[~k].sum(axis=0).max() for k in known]
            assert found == pytest.approx(max(best) / angles)


def test_a_latent_reaches_the_goals_between_those_where_its_episodes_are_rewarded() -> None:
    far, length = np.array([-20.0, -30.0, -20.0, -25.0]), np.ones((4, 2, 3))
    returns = far[:, None, None] - np.array([1.0, 2.0])[:, None] * length  # control costs
    returns[0, 0, 1] += 9.0
    returns[2, 0, 2] += 9.0
    found = search.reached(search.Recorded(returns, length, far))
    assert found.tolist() == [[True, False], [True, False], [True, False], [False, False]]


def test_bounds_of_the_walking_robots() -> None:
    rng = np.random.default_rng(0)
    speeds, goals = rng.uniform(0.0, 3.0, 25), rng.uniform(-2.0, 2.0, (25, 2))
    tried = -200 * np.abs(np.linspace(0, 3, 3001)[:, None] - speeds).mean(1).min()
    np.testing.assert_allclose(walking.bounds("cheetah_vel", speeds), [tried, 0.0], atol=0.1)
    grid = np.stack(np.meshgrid(*[np.linspace(-2, 2, 401)] * 2), -1).reshape(-1, 1, 2)
    dense = -200 * np.abs(grid - goals).sum(-1).mean(1).min()
    np.testing.assert_allclose(walking.bounds("ant_goal", goals), [dense, 0.0], atol=1.0)
    # One goal that a place of the grid hits, and one that is out of its reach.
    two = np.array([[0.3, 0.0], [-1.5, 0.0]])
    expected = 200 * (1.0 - 0.75) / 2, 200.0
    np.testing.assert_allclose(walking.bounds("sparse_ant_goal", two), expected, atol=1e-6)
    assert walking.bounds("ant_dir", goals).blind == 200.0


@pytest.mark.long
def test_a_walking_robot_that_stands_still() -> None:
    # It stands where it starts: 3 m are left to the farthest goals, and a sixteenth is reached.
    assert -150.0 < walking.standing_return("sparse_ant_goal") < -115.0
