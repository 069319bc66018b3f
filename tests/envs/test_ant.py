"""The ant's observations, controls, starts, rewards and ends, against the facts."""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from maesn.envs import Ant, RewardKind, Variant
from maesn.envs.ant import rotation_matrix

# u = clip(a, -1, 1) = (.5, -1, 0, ...): sum u^2 = 1.25, control cost .005 * 1.25 = .00625.
ACTION = jnp.zeros(8).at[:2].set(jnp.array([0.5, -3.0]))
# Contact forces: 2 is clipped to 1, and .5 stays: cost .0005 (1 + .25) = .000625. The last body is
# the marker of the goal, which is no part of the ant and must not count.
OTHER = 0.05 - 0.00625 - 0.000625
# A goal at |(1.2, 1.6)|_2 = 2 from the start, |.|_1 = 2.8.
GOAL = (1.2, 1.6)
# Places of the centre of mass, and their distances: (0.6, 0.8) is 1 away (|.|_1 = 1.4),
# (0.96, 1.28) is 0.4 away (|.|_1 = 0.56). By |.|_1, (0.7, 1.1) would be 1 away; it is .7071.
FAR, NEAR, DIAGONAL = (0.6, 0.8), (0.96, 1.28), (0.7, 1.1)
GOAL_PART = {
    ("reference", "dense", FAR): 4 - 1.4,
    ("reference", "dense", NEAR): 4 - 0.56,
    ("reference", "dense", DIAGONAL): 4 - 1.0,
    ("reference", "sparse", FAR): 4 - 2.8,
    ("reference", "sparse", NEAR): 4 - 0.56,
    ("reference", "sparse", DIAGONAL): 4 - 1.0,
    ("paper", "dense", FAR): -1.0,
    ("paper", "dense", NEAR): -0.4,
    ("paper", "dense", DIAGONAL): -(0.5**0.5),
    ("paper", "sparse", FAR): 4 - 2.0,
    ("paper", "sparse", NEAR): 4 - 0.4,
    ("paper", "sparse", DIAGONAL): 4 - 0.5**0.5,
}


def state(place: tuple[float, float] = (0.0, 0.0), **others: Any) -> dict[str, jax.Array]:
    """A standing ant whose centre of mass is at that place; its torso's must not matter."""
    qpos, _ = Ant().initial(jax.random.key(0), jnp.zeros(2))
    forces = jnp.zeros((15, 6)).at[4, 2].set(2.0).at[7, 5].set(-0.5).at[14].set(0.7)
    centres = jnp.full((15, 3), 9.0).at[1, :2].set(jnp.array(place))
    readings = {"qpos": qpos.at[:2].set(-7.0), "qvel": jnp.zeros(14)}
    return readings | {"cfrc_ext": forces, "subtree_com": centres} | others


@pytest.mark.parametrize(("variant", "reward_kind", "place"), GOAL_PART)
def test_reward_by_hand(
    variant: Variant, reward_kind: RewardKind, place: tuple[float, float]
) -> None:
    env = Ant(variant=variant, reward_kind=reward_kind)
    calm = state((5.0, 5.0), cfrc_ext=jnp.zeros((15, 6)))  # what was before must not matter
    reward = env.reward(calm, ACTION, state(place), jnp.array(GOAL))
    other = OTHER if variant == "reference" else 0.0
    expected = GOAL_PART[variant, reward_kind, place]
    assert float(reward.goal) == pytest.approx(expected, abs=1e-6)
    assert float(reward.other) == pytest.approx(other, abs=1e-7)
    assert float(reward.total) == pytest.approx(expected + other, abs=1e-6)


@pytest.mark.parametrize(("place", "reached"), [(FAR, False), (NEAR, True), (DIAGONAL, True)])
def test_the_goal_is_reached_within_the_euclidean_radius(place: Any, reached: bool) -> None:
    assert bool(Ant().solved(state(place), jnp.array(GOAL))) is reached


def test_variants_pay_differently_far_from_a_goal_that_is_nearer() -> None:
    # |g|_1 = .6 + .8; the paper's constant is the same for all tasks.
    for variant, expected in {"reference": 4 - 1.4, "paper": 4 - 2.0}.items():
        env = Ant(variant=variant, reward_kind="sparse")
        reward = env.reward(state(), ACTION, state((3.0, 3.0)), jnp.array([0.6, 0.8]))
        assert float(reward.goal) == pytest.approx(expected, abs=1e-6)
        assert env.uninformative_reward == 4 - 2.0


@pytest.mark.parametrize(
    ("height", "ends"),
    [(0.199, True), (0.201, False), (0.55, False), (0.999, False), (1.001, True)],
)
def test_the_reference_ends_an_episode_when_the_torso_leaves_its_heights(
    height: float, ends: bool
) -> None:
    there = state()
    there["qpos"] = there["qpos"].at[2].set(height)
    assert bool(Ant().terminated(there)) is ends
    # The paper's dense reward is never positive: an end would be the best that can happen.
    assert not bool(Ant(variant="paper").terminated(there))


@pytest.mark.parametrize("variant", ["reference", "paper"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e11])
@pytest.mark.parametrize(("name", "index"), [("qpos", 11), ("qvel", 13)])
def test_a_state_that_blows_up_ends_the_episode_and_is_rewarded_like_the_one_before(
    variant: Variant, value: float, name: str, index: int
) -> None:
    env, goal = Ant(variant=variant), jnp.array(GOAL)
    lost = {key: jnp.full_like(reading, value) for key, reading in state().items()}
    only = state((3.0, 3.0))
    only[name] = only[name].at[index].set(value)
    unmoved = env.reward(state(), ACTION, state(NEAR), goal)
    for after in (lost, only):
        assert bool(env.terminated(after))
        reward = env.reward(state(NEAR), ACTION, after, goal)
        np.testing.assert_array_equal(jnp.stack(reward), jnp.stack(unmoved))
    assert not bool(env.solved(lost, goal))


def test_figures_show_the_centre_of_mass() -> None:
    # `tests/worlds/test_native.py` has the order of all that is seen.
    np.testing.assert_array_equal(Ant().position(jnp.arange(125.0)), [122.0, 123.0])
    np.testing.assert_array_equal(Ant().goal(jnp.array([3.0, 4.0])), [3.0, 4.0])


def test_rotation_of_quaternions_of_any_length() -> None:
    for quaternion in np.random.default_rng(2).normal(size=(20, 4)):
        unit, axes = quaternion / np.linalg.norm(quaternion), np.empty(9)
        mujoco.mju_quat2Mat(axes, unit)
        got = rotation_matrix(jnp.asarray(quaternion, jnp.float32))
        np.testing.assert_allclose(got, axes.reshape(3, 3), atol=1e-6)
