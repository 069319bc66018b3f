"""The reward of driving to a goal, against numbers worked out by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maesn.envs import Point, RewardKind, Variant, Wheeled
from maesn.envs.goals import goal_reward

# A goal 2 m from the start: |(1.2, 1.6)|^2 = 1.44 + 2.56 = 4.
GOAL = (1.2, 1.6)
# The robot has driven straight towards it, so d = 2 - (distance driven):
#   far:  driven 1 m,   |(0.6, 0.8)| = 1,                    d = 1
#   near: driven 1.6 m, |(0.96, 1.28)|^2 = .9216 + 1.6384,   d = 0.4
FAR, NEAR = (0.6, 0.8), (0.96, 1.28)
# Wheeled: u = clip(2 a, -2, 2), so a = (0.5, -3) gives u = (1, -2): cost 0.05 (1 + 4) = 0.25.
# Point:   u = clip(a, -1, 1),   so a = (0.5, -3) gives u = (0.5, -1): cost 0.05 (.25 + 1) = 0.0625.
ACTION = (0.5, -3.0)
COST = {Wheeled: 0.25, Point: 0.0625}

# The goal's part: dense -d; sparse, where d > radius, -|g| = -2 or -c_max = -2.
GOAL_PART = {
    ("dense", FAR): -1.0,
    ("dense", NEAR): -0.4,
    ("sparse", FAR): -2.0,
    ("sparse", NEAR): -0.4,
}


def readings(env: Wheeled | Point, place: tuple[float, float]) -> dict[str, jax.Array]:
    """A state at that place, whose other coordinates must not matter."""
    size = {Wheeled: 6, Point: 2}[type(env)]
    qpos = jnp.full(size, 7.0).at[:2].set(jnp.array(place))
    return {"qpos": qpos, "qvel": jnp.full(size, -9.0)}


@pytest.mark.parametrize("make_env", [Wheeled, Point])
@pytest.mark.parametrize("variant", ["reference", "paper"])
@pytest.mark.parametrize(("reward_kind", "place"), GOAL_PART)
def test_reward_by_hand(
    make_env: type, variant: Variant, reward_kind: RewardKind, place: tuple[float, float]
) -> None:
    env = make_env(variant=variant, reward_kind=reward_kind)
    before, after = readings(env, (5.0, 5.0)), readings(env, place)
    reward = env.reward(before, jnp.array(ACTION), after, jnp.array(GOAL))
    cost = COST[make_env] if variant == "reference" else 0.0
    assert float(reward.goal) == pytest.approx(GOAL_PART[reward_kind, place], abs=1e-6)
    assert float(reward.other) == pytest.approx(-cost, abs=1e-6)
    assert float(reward.total) == pytest.approx(GOAL_PART[reward_kind, place] - cost, abs=1e-6)


@pytest.mark.parametrize("make_env", [Wheeled, Point])
def test_variants_pay_differently_far_from_a_goal_that_is_nearer(make_env: type) -> None:
    # |g| = |(0.6, 0.8)| = 1 and d = 6 - 1 = 5 from the place (3.6, 4.8), which is 6 from the start.
    goal, place = jnp.array([0.6, 0.8]), (3.6, 4.8)
    for variant, expected in {"reference": -1.0, "paper": -2.0}.items():
        env = make_env(variant=variant, reward_kind="sparse")
        reward = env.reward(readings(env, FAR), jnp.zeros(2), readings(env, place), goal)
        assert float(reward.total) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("make_env", [Wheeled, Point])
def test_the_edge_of_the_radius_belongs_to_the_goal_region(make_env: type) -> None:
    # 0.5 and 1.5 have exact binary forms, so d = 2 - 1.5 is exactly the radius.
    env = make_env(variant="paper", reward_kind="sparse", sparse_radius=0.5)
    goal = jnp.array([2.0, 0.0])
    edge = readings(env, (1.5, 0.0))
    outside = readings(env, (float(np.nextafter(np.float32(1.5), np.float32(0.0))), 0.0))
    for state, reached, expected in ((edge, True, -0.5), (outside, False, -2.0)):
        assert bool(env.solved(state, goal)) is reached
        assert float(env.reward(edge, jnp.zeros(2), state, goal).total) == expected


def test_a_reward_that_is_not_a_number_stays_one() -> None:
    # A comparison with NaN is false: the sparse reward must not turn NaN into the safe constant.
    assert bool(jnp.isnan(goal_reward(jnp.float32(jnp.nan), -2.0, "sparse", 0.5)))
