"""Task sets: finite, disjoint, the same everywhere, and drawn as the paper says."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bernoulli_bandit import bandit
from chain import chain
from scipy import stats

from maesn.envs import FAMILIES, SETS, TaskFamily, TaskSet

# Pinned: a learner's latents belong to these very tasks, and a checkpoint names their digest, of
# which the first half stands here.
DIGESTS = {
    "point": "c0b923e3 a5247b9d 13be3c6b d1457bfc 1758bc79",
    "wheeled": "e16cc188 2aca6d26 70ca09ac 431567cb a6e1e522",
    "ant": "5a00652a 8a7f1a18 382f9297 a761d25c f11584e0",
    "blockpush": "bb4c755e 9e05bbfe 9b619583 b422aeb1 ff21f446",
    "sparse_point": "a869c773 38a43f67 f15ab50b 34df464e 4b991db8",
    "cheetah_vel": "38b037e4 794655e5 a8a7704c 511adaa5 0e1dab6c",
    "cheetah_body": "98e95117 ed5d6fa4 f0d14d42 05466087 df0d1476",
    "ant_dir": "f63f2525 eb904d8e a1435076 3f48c2b5 eefaebdc",
    "ant_goal": "8db328ee a6234829 5b6218a3 2dc5868e 896149a3",
    "sparse_ant_goal": "3572510a 0e1a7f7f 0f68b85e 0f7ebea7 ba195f3c",
    "bandit": "97273fe9 0f8d6e0d 5b5558cb 137d5885 e6b785da",
    "chain": "c6665112 b2e80fa0 aad02583 e68350dc 11e5ac24",
}
ON_HALF_CIRCLES = {"point": 2.0, "wheeled": 2.0, "ant": 2.0, "sparse_point": 1.0}
EVERY = FAMILIES | {"bandit": bandit, "chain": chain}
DRAWN = [name for name, family in EVERY.items() if family.num_tasks is None]


def rows(family: TaskFamily, name: str) -> np.ndarray:
    leaves = jax.tree.leaves(family.task_set(name).tasks)
    return np.concatenate([np.asarray(leaf).reshape(100, -1) for leaf in leaves], axis=1)


@pytest.mark.parametrize("name", DRAWN)
def test_sets_of_a_hundred_tasks_that_never_change(name: str) -> None:
    sets = [EVERY[name].task_set(which) for which in SETS]
    assert [len(tasks) for tasks in sets] == [100] * len(SETS)
    assert [tasks.digest()[:8] for tasks in sets] == DIGESTS[name].split()


@pytest.mark.parametrize("name", DRAWN)
def test_no_task_comes_twice(name: str) -> None:
    tasks = np.concatenate([rows(EVERY[name], which) for which in SETS])
    assert len(np.unique(tasks, axis=0)) == 100 * len(SETS)


@pytest.mark.parametrize(
    ("name", "count", "digest"),
    [("grid_navi", 21, "03584e89fb510693"), ("cheetah_dir", 2, "0f1b4cef39893a2c")],
)
def test_every_set_of_a_family_with_few_tasks_is_all_of_them(
    name: str, count: int, digest: str
) -> None:
    family = FAMILIES[name]
    sets = [family.task_set(which) for which in SETS]
    assert [len(tasks) for tasks in sets] == [count] * len(SETS)
    assert {tasks.digest() for tasks in sets} == {digest}
    np.testing.assert_array_equal(family.task_set("test", 1).tasks, sets[0].tasks[:1])


def test_families_have_seeds_of_their_own() -> None:
    assert len({family.seed for family in EVERY.values()}) == len(EVERY)


@pytest.mark.parametrize("name", ON_HALF_CIRCLES)
def test_goals_are_uniform_on_the_upper_half_circle(name: str) -> None:
    many = EVERY[name].draw_tasks(np.random.default_rng(3), 20_000)
    for goals in (*(rows(EVERY[name], which) for which in SETS), many):
        radius = np.linalg.norm(goals.astype(float), axis=1)
        np.testing.assert_allclose(radius, ON_HALF_CIRCLES[name], rtol=1e-6)
        angles = np.degrees(np.arctan2(*goals.astype(float).T[::-1]))
        assert angles.min() >= 0
        assert angles.max() < 180
        # Kolmogorov-Smirnov. The sets are fixed, so this holds for good or not at all; of twenty
        # draws from the right distribution, one in fifty would fail here.
        assert stats.kstest(angles, stats.uniform(0, 180).cdf).pvalue > 1e-3


@pytest.mark.parametrize("name", ON_HALF_CIRCLES)
def test_goals_out_of_distribution_are_none_that_training_shows(name: str) -> None:
    goals = rows(EVERY[name], "ood").astype(np.float64) * 2.0 / ON_HALF_CIRCLES[name]
    radius = np.linalg.norm(goals, axis=1)
    below, near, far = goals[:, 1] < 0, radius < 1.61, radius > 2.39
    assert (below.astype(int) + near + far == 1).all()
    np.testing.assert_allclose(radius[below], 2.0, rtol=1e-6)
    assert radius.min() >= 1.2 - 1e-6
    assert radius.max() <= 2.8 + 1e-6
    assert [below.sum(), near.sum(), far.sum()] == [34, 33, 33]


def test_a_family_without_tasks_out_of_distribution_says_so() -> None:
    with pytest.raises(ValueError, match="`chain` has the task sets training, validation"):
        chain.task_set("ood")


class Pair(NamedTuple):
    goal: np.ndarray
    mass: np.ndarray


def test_a_set_of_structured_tasks_is_indexed_leaf_by_leaf() -> None:
    tasks = TaskSet(Pair(np.arange(6.0).reshape(3, 2), np.arange(3.0)))
    assert len(tasks) == 3
    assert tasks[1].mass == 1
    np.testing.assert_array_equal(tasks[jnp.array([2, 0, 2])].goal, [[4, 5], [0, 1], [4, 5]])
    np.testing.assert_array_equal(tasks[1:].mass, [1, 2])


def test_the_digest_tells_values_shapes_types_and_structures_apart() -> None:
    goal, mass = np.arange(6, dtype=np.float32).reshape(3, 2), np.zeros(3, np.float32)
    changed = goal.copy()
    changed[2, 1] = np.nextafter(changed[2, 1], np.float32(9))
    variations = [
        Pair(goal, mass),
        Pair(changed, mass),
        Pair(goal.reshape(3, 2, 1), mass),
        Pair(goal.view(np.int32), mass),
        Pair(mass, goal),
        {"goal": goal, "mass": mass},
    ]
    assert len({TaskSet(tasks).digest() for tasks in variations}) == len(variations)
    assert TaskSet(jnp.asarray(goal)).digest() == TaskSet(goal).digest()
    assert TaskSet(np.asfortranarray(goal)).digest() == TaskSet(goal).digest()
