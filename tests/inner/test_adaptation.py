"""The inner step against the reference and against its closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.prepared import UNEQUAL, Problem, make_problem, stack
from learning_problems.translation import (
    advantages_of,
    learner_for,
    policy_to_reference,
    to_library,
    to_policy,
)
from reference.maesn import Agent as ReferenceAgent
from reference.maesn import Settings, pathwise_gradient, start

from maesn.context import Bias, BiasContext, Latent, LatentContext, NoContext, Nothing
from maesn.experience.agent import Agent, Agents
from maesn.experience.episodes import Episodes
from maesn.inner.adaptation import Adaptation, InnerStep, StepSchedule, StepSizes
from maesn.inner.advantage import AdvantageEstimator, Advantages
from maesn.policies import GaussianMLP

SETTINGS = {
    "likelihood_ratio": Settings(),
    "reparameterized": Settings(gradient="reparameterized"),
    "theta_as_well": Settings(theta_step=0.1),
}
jitted = eqx.filter_jit(lambda adaptation, *arguments: adaptation(*arguments))


def played(problem: Problem) -> tuple[Episodes, Advantages]:
    """Return what was played in all rows before the first inner update."""
    episodes = stack(problem.batches(0))
    return episodes, advantages_of(AdvantageEstimator(), episodes)


def agents_of(problem: Problem) -> tuple[Agents, StepSizes]:
    parameters = to_library(problem.parameters)
    return Agents(parameters.policy, parameters.context_table, True), parameters.step_sizes


def assert_moved_like_the_reference(problem: Problem, rtol: float, atol: float) -> None:
    learner = learner_for(problem)
    agents, sizes = agents_of(problem)
    moved = jitted(learner.adaptation, agents, sizes, learner.context, *played(problem))
    assert moved.shares_policy == (problem.settings.theta_step == 0)
    for row, expected in enumerate(problem.playing(1)):
        np.testing.assert_allclose(moved.context.mean[row], expected.mean, rtol, atol)
        np.testing.assert_allclose(moved.context.log_std[row], expected.log_std, rtol, atol)
        pick = slice(None) if moved.shares_policy else row
        theta = policy_to_reference(jax.tree.map(lambda x, pick=pick: x[pick], moved.policy))
        for name, array in expected.theta.items():
            np.testing.assert_allclose(theta[name], array, rtol, atol, err_msg=name)


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.usefixtures("x64")
def test_inner_update(name: str) -> None:
    problem = make_problem(0, UNEQUAL, SETTINGS[name])
    assert_moved_like_the_reference(problem, rtol=1e-11, atol=1e-12)


def test_inner_update_in_single_precision() -> None:
    problem = make_problem(0, UNEQUAL, SETTINGS["theta_as_well"])
    assert_moved_like_the_reference(problem, rtol=0.0, atol=2e-4)


@pytest.mark.usefixtures("x64")
def test_every_weight_has_a_step_size_of_its_own() -> None:
    problem = make_problem(0, UNEQUAL)
    rng = np.random.default_rng(1)
    theta = start(problem.parameters, 0).theta
    step = {name: rng.normal(size=array.shape) for name, array in theta.items()}
    agents, _ = agents_of(problem)
    adaptation = Adaptation(policy=InnerStep())
    moved = jitted(
        adaptation, agents, StepSizes(to_policy(step), None), LatentContext(), *played(problem)
    )
    for row, task in enumerate(problem.tasks):
        slope, _, _ = pathwise_gradient(start(problem.parameters, row), task.pre[0], redrawn=False)
        actual = policy_to_reference(jax.tree.map(lambda x, row=row: x[row], moved.policy))
        for name in theta:
            expected = theta[name] + step[name] * slope[name]
            np.testing.assert_allclose(actual[name], expected, rtol=1e-11, atol=1e-12)
    np.testing.assert_array_equal(moved.context.mean, agents.context.mean)


@pytest.mark.usefixtures("x64")
def test_a_bias_moves_along_the_gradient_through_the_policy() -> None:
    problem = make_problem(0, UNEQUAL)
    bias, step = np.array([0.3, -0.2]), np.array([0.5, 2.0])
    agents = Agents(
        to_policy(problem.parameters),
        Bias(jnp.broadcast_to(jnp.asarray(bias), (len(problem.tasks), 2))),
        shares_policy=True,
    )
    sizes = StepSizes(None, Bias(jnp.asarray(step)))
    adaptation = Adaptation(context=InnerStep())
    moved = jitted(adaptation, agents, sizes, BiasContext(2), *played(problem))
    for row, task in enumerate(problem.tasks):
        # A latent without spread is a bias.
        agent = ReferenceAgent(start(problem.parameters, row).theta, bias, np.full(2, -np.inf))
        _, slope, _ = pathwise_gradient(agent, task.pre[0], redrawn=True)
        np.testing.assert_allclose(moved.context.value[row], bias + step * slope, rtol=1e-11)


def test_fixed_sizes_are_not_learned_and_learned_ones_start_where_they_are_told() -> None:
    agent = Agent(GaussianMLP((5,)).init(jax.random.key(0), 3, 2, 2), Latent(*2 * [jnp.ones(2)]))
    fixed = Adaptation(InnerStep(0.1, learned=False), InnerStep(2.0, learned=False))
    assert jax.tree.leaves(fixed.init(agent)) == []
    learned = Adaptation(InnerStep(0.1), InnerStep(2.0)).init(agent)
    assert jax.tree.structure(learned.policy) == jax.tree.structure(agent.policy)
    for sizes, part, value in (
        (learned.policy, agent.policy, 0.1), (learned.context, agent.context, 2.0)
    ):  # fmt: skip
        for size, parameter in zip(jax.tree.leaves(sizes), jax.tree.leaves(part), strict=True):
            np.testing.assert_array_equal(size, np.full(parameter.shape, np.float32(value)))


def test_a_part_rests_until_its_stage_begins() -> None:
    adaptation = Adaptation(InnerStep(0.1, first_iteration=150), InnerStep(1.0))
    assert adaptation.at(149) == Adaptation(None, InnerStep(1.0))
    assert adaptation.at(150) == adaptation.at(10_000) == adaptation


def test_nothing_to_adapt_leaves_the_agents_as_they_are() -> None:
    problem = make_problem(0, UNEQUAL, latent=0)
    agents = Agents(to_policy(problem.parameters), Nothing(), shares_policy=True)
    moved = jitted(Adaptation(), agents, StepSizes(None, None), NoContext(), *played(problem))
    assert moved.shares_policy
    for old, new in zip(jax.tree.leaves(agents), jax.tree.leaves(moved), strict=True):
        np.testing.assert_array_equal(old, new)


@pytest.mark.parametrize(
    ("schedule", "expected"),
    [
        (StepSchedule(), [1, 1, 1 / 2, 1 / 4, 1 / 8, 1 / 16]),
        (StepSchedule(full_steps=3), [1, 1, 1, 1 / 2, 1 / 4, 1 / 8]),
        (StepSchedule(full_steps=1, factor=0.1), [1, 0.1, 0.01, 1e-3, 1e-4, 1e-5]),
        (StepSchedule(factor=1.0), [1, 1, 1, 1, 1, 1]),
        (StepSchedule(scale=4.0), [4, 4, 2, 1, 1 / 2, 1 / 4]),
    ],
)
def test_step_schedule(schedule: StepSchedule, expected: list[float]) -> None:
    actual = [schedule(jnp.asarray(update)) for update in range(len(expected))]
    np.testing.assert_allclose(actual, expected, rtol=1e-6)
