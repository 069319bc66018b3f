"""Learning from scratch: REINFORCE's and TRPO's steps against NumPy and against closed forms."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from learning_problems.prepared import UNEQUAL, make_problem, stack
from learning_problems.transitions import episodes_of
from learning_problems.translation import policy_to_reference, to_policy
from playing import keys
from reference.policy_gradient import reinforce_step, trpo_step
from reference.trust_region import TrustRegionSettings

from maesn import PolicyGradient, TrustRegionStep
from maesn.context import Nothing
from maesn.envs import find_family
from maesn.evaluation.adapting import adapt
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.inner.advantage import AdvantageEstimator
from maesn.learners import SCRATCH, GradientStep, PolicyImprovement
from maesn.networks import MLP, Linear
from maesn.numerics import DiagonalGaussian
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import GaussianMLP, GaussianMLPPolicy
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

ROWS = (0, 3)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("garbage", [0.0, np.nan])
@pytest.mark.parametrize("method", ["reinforce", "trpo"])
def test_a_step_in_two_tasks_is_the_references_in_each(method: str, garbage: float) -> None:
    problem = make_problem(2, UNEQUAL, inner_updates=0, latent=0)
    theta = to_policy(problem.parameters)
    rules = {"reinforce": GradientStep(0.3), "trpo": TrustRegionStep(TrustRegion(cg_steps=10), 1)}
    improvement = PolicyImprovement(rules[method])
    state = improvement.begin(keys(2), Agents(stacked(theta, 2), Nothing(), shares_policy=False))
    batch = problem.batches(0)
    moved = improvement(state, stack([batch[row] for row in ROWS], garbage)).agents.policy
    reference = policy_to_reference(theta)
    for slot, row in enumerate(ROWS):
        played = problem.tasks[row].post
        if method == "reinforce":
            expected = reinforce_step(reference, played, 0.3)
        else:
            outcome = trpo_step(reference, played, TrustRegionSettings())
            assert outcome.accepted
            expected = outcome.parameters
        found = policy_to_reference(jax.tree.map(lambda x, slot=slot: x[slot], moved))
        for name, value in found.items():
            np.testing.assert_allclose(value, expected[name], rtol=1e-6, atol=1e-8)
            assert (np.abs(value - reference[name]) > 1e-6).any()


def stacked(policy: GaussianMLPPolicy, number: int) -> GaussianMLPPolicy:
    return jax.tree.map(lambda x: jnp.stack([x] * number), policy)


GOAL, MEAN, STD, NUMBER = 0.7, 0.2, 0.5, 40_000


def quadratic_bandit() -> tuple[Agents, Episodes]:
    """One action per episode, drawn from N(mean, std²); the reward is -(a - goal)²."""
    action = MEAN + STD * jax.random.normal(jax.random.key(0), (1, NUMBER, 1, 1))
    distribution = DiagonalGaussian(
        jnp.full(action.shape, MEAN), jnp.full(action.shape, np.log(STD))
    )
    episodes = episodes_of(np.zeros((1, NUMBER, 2, 1)), action, behaviour=distribution)
    layer = Linear(jnp.zeros((1, 1, 1)), jnp.full((1, 1), MEAN))
    policy = GaussianMLPPolicy(MLP((layer,)), jnp.full((1, 1), np.log(STD)))
    rewarded = replace(episodes, reward=-((action[..., 0] - GOAL) ** 2))
    return Agents(policy, Nothing(), shares_policy=False), rewarded


def moved_by(rule: GradientStep | TrustRegionStep) -> np.ndarray:
    """How far one step moves (mean, log std)."""
    agents, episodes = quadratic_bandit()
    improvement = PolicyImprovement(rule, AdvantageEstimator(ridge=1e-3))
    state = improvement.begin(keys(1), agents)
    policy = improvement(state, episodes).agents.policy
    (layer,) = policy.mlp.layers
    assert np.all(layer.weight == 0)  # the observation is 0
    return np.array([layer.bias.item() - MEAN, policy.log_std.item() - np.log(STD)])


# E[-(a - g)²] = -(m - g)² - s², so its slopes in m and log s are -2 (m - g) and -2 s². Advantages
# are divided by the standard deviation of the reward: its variance is 2 s⁴ + 4 s² (m - g)².
SLOPE = np.array([-2 * (MEAN - GOAL), -2 * STD**2])


def test_adam_scales_the_step() -> None:
    # Its first step has the size asked for, whatever the gradient.
    found = moved_by(GradientStep(step_size=0.01, scaling="adam"))
    np.testing.assert_allclose(found, 0.01 * np.sign(SLOPE), rtol=1e-3)


def small(name: str, **settings: object) -> PolicyGradient:
    return SCRATCH[name](2, 2, policy=GaussianMLP((8,)), **settings)


@pytest.fixture(scope="module")
def collect() -> Collector:
    family = find_family("point")
    env = family.make_env(reward_kind="dense", horizon=10)
    return Collector(make_world(env, family.task_set("test", size=4)), 8)


@pytest.mark.parametrize("name", [pytest.param("reinforce", marks=pytest.mark.long), "trpo"])
def test_every_task_learns_on_its_own(name: str, collect: Collector) -> None:
    learner = small(name)
    returns = adapt(learner, collect, episodes=64).curves.mean_return
    assert returns.shape == (4, 9)
    assert np.all(returns[:, -1] > returns[:, 0])


def test_tasks_start_with_different_weights_that_the_seed_says() -> None:
    learner = small("trpo")
    one, same, other = (
        jax.tree.leaves(learner.init(keys(2, seed)).agents.policy) for seed in (0, 0, 1)
    )
    for first, second, third in zip(one[:1], same[:1], other[:1], strict=True):
        np.testing.assert_array_equal(first, second)
        assert (first[0] != first[1]).any()
        assert (first != third).any()


def flat(policy: GaussianMLPPolicy) -> jax.Array:
    return ravel_pytree(policy)[0]


@pytest.mark.parametrize(("name", "drifts"), [("trpo", True), ("reinforce", False)])
def test_equal_pay_moves_who_drifts(name: str, drifts: bool, collect: Collector) -> None:
    learner = small(name)
    state = learner.init(keys(4))
    played = collect(keys(4), learner.agents(state), jnp.arange(4))
    for rewarded, moves in ((0.0, False), (-1.0, drifts)):
        equal = replace(played, reward=jnp.full_like(played.reward, rewarded))
        after = learner.update(state, equal)
        old, new = (jax.vmap(flat)(one.agents.policy) for one in (state, after))
        np.testing.assert_array_equal(jnp.any(old != new, axis=1), moves)
        assert int(after.update) == 1


def test_vpg_is_reinforce() -> None:
    assert SCRATCH["vpg"](3, 2) == SCRATCH["reinforce"](3, 2)
