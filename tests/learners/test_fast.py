"""Adaptation to new tasks against the reference's inner update, step by step."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.prepared import LATENT, UNEQUAL, make_problem, play, stack
from learning_problems.translation import learner_for, to_library
from playing import assert_same, keys
from reference.advantage import experience
from reference.maesn import Agent, inner_update, start

from maesn import FineTuning, maesn, maesn_theta, maml, rl2
from maesn.context import Latent
from maesn.inner.adaptation import Adaptation, InnerStep
from maesn.learners import PRESETS, SCRATCH, Capabilities, Problem
from maesn.learners.gradient.fast_learner import GradientFastLearner
from maesn.learners.gradient.meta_learner import GradientState
from maesn.learners.presets import latent_space
from maesn.policies import GaussianMLP

TASKS = 3
pytestmark = pytest.mark.usefixtures("x64")


def fast_learner(preset: str) -> GradientFastLearner:
    problem = make_problem(2, UNEQUAL)
    learner = learner_for(problem)
    if preset == "latent_space":
        settings = latent_space()
        learner = replace(learner, adaptation=settings.adaptation, schedule=settings.schedule)
    return learner.fast_learner(GradientState(to_library(problem.parameters), jnp.zeros((), int)))


@pytest.mark.parametrize(
    ("preset", "scales"),
    [("maesn", [1, 1, 1 / 2, 1 / 4, 1 / 8]), ("latent_space", [1, 1, 1, 1 / 2, 1 / 4])],
)
def test_new_tasks_start_at_the_prior_and_move_by_the_schedule(
    preset: str, scales: list[float]
) -> None:
    problem, rng = make_problem(2, UNEQUAL), np.random.default_rng(0)
    # MAESN moves by the step sizes that it has learned, LatentSpace by 1.
    names = ("mean_step", "log_std_step")
    steps = [problem.parameters[name] if preset == "maesn" else np.ones(LATENT) for name in names]
    theta = start(problem.parameters, 0).theta
    expected = [Agent(theta, np.zeros(LATENT), np.zeros(LATENT)) for _ in range(TASKS)]
    learner = fast_learner(preset)
    state = learner.init(keys(TASKS))
    for scale in scales:
        np.testing.assert_allclose(
            state.agents.context.mean, [agent.mean for agent in expected], atol=1e-10
        )
        np.testing.assert_allclose(
            state.agents.context.log_std, [agent.log_std for agent in expected], atol=1e-10
        )
        batch = [play(rng, theta, agent.mean, agent.log_std, UNEQUAL) for agent in expected]
        state = learner.update(state, stack(batch))
        expected = [
            inner_update(
                agent,
                *(scale * step for step in steps),
                experience(episodes, problem.advantage),
                problem.settings,
            )
            for agent, episodes in zip(expected, batch, strict=True)
        ]
    assert state.update == len(scales)
    assert state.agents.shares_policy
    assert_same(state.agents.policy, learner.policy)
    np.testing.assert_allclose(
        state.agents.context.mean, [agent.mean for agent in expected], atol=1e-10
    )


CAN = {
    "maesn": Capabilities(least_episodes=2),
    "latent_space": Capabilities(least_episodes=2),
    "maesn_theta": Capabilities(least_episodes=2),  # in its first stage
    "maml": Capabilities(),
    "maml_bias": Capabilities(),
    "maml_bias_only": Capabilities(),
    "rl2": Capabilities(is_recurrent=True, trial_episodes=2, learns_from_reward=False),
    "oracle": Capabilities(learns_from_reward=False),
    "pearl": Capabilities(learns_from_reward=False),
}


@pytest.mark.parametrize("method", CAN)
def test_learners_say_what_they_can(method: str) -> None:
    meta = PRESETS[method]()
    learner = meta.fast_learner(meta.init(jax.random.key(0), Problem(2, 2, 20, 2)))
    assert learner.capabilities == CAN[method]


def test_a_latent_is_deployed_at_its_mean() -> None:
    inner = fast_learner("maesn")
    at = Latent(jnp.array([[1.0, -2.0]]), jnp.array([[0.5, 0.0]]))
    begun = inner.init(keys(1))
    explored = replace(begun, agents=replace(begun.agents, context=at))
    tuned = FineTuning(inner, after=0)
    for learner, state in ((inner, explored), (tuned, tuned.init(keys(1)))):
        explore, deploy = (learner.agents(state, purpose) for purpose in ("explore", "deploy"))
        np.testing.assert_array_equal(deploy.context.mean, explore.context.mean)
        z = jax.vmap(lambda one: one.draw(jnp.full(2, 3.0), jnp.zeros(0)))(deploy.context)
        np.testing.assert_allclose(z, explore.context.mean, atol=1e-5)
        assert np.all(explore.context.log_std > np.log(0.5))
    trpo = SCRATCH["trpo"](2, 2)
    state = trpo.init(keys(1))
    for one, other in zip(
        *(jax.tree.leaves(trpo.agents(state, p)) for p in ("explore", "deploy")), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_a_latent_that_compares_episodes_needs_two_of_them() -> None:
    """With one, its standardised advantage is 0 and it would stand still without a word."""
    problem, rng = make_problem(2, UNEQUAL), np.random.default_rng(0)
    theta = start(problem.parameters, 0).theta
    episodes = stack([play(rng, theta, np.zeros(LATENT), np.zeros(LATENT), UNEQUAL)])
    single = jax.tree.map(lambda x: x[:, :1], episodes)
    learner = fast_learner("maesn")
    message = "at least 2 episodes of a task, got 1: .* Play more episodes per update"
    with pytest.raises(ValueError, match=message):
        learner.update(learner.init(keys(1)), single)
    for preset in (maesn, maesn_theta):
        with pytest.raises(ValueError, match=message):
            preset().check_batch(1)
        preset().check_batch(2)
    # Without an inner update nothing can stand still; and whatever else moves can learn from one.
    for method in ("latent_space", "maml", "maml_bias", "maml_bias_only", "oracle"):
        PRESETS[method]().check_batch(1)
    maesn(adaptation=Adaptation(InnerStep(0.1), InnerStep(1.0))).check_batch(1)
    rl2(meta_batch_size=40).check_batch(1)
    meta = maml(policy=GaussianMLP((4,)))
    sizes = (single.observation.shape[-1], single.action.shape[-1])
    weights = meta.fast_learner(meta.init(jax.random.key(0), Problem(*sizes, 20)))
    moved = weights.update(weights.init(keys(1)), replace(single, z=jnp.zeros((1, 1, 0))))
    assert not np.array_equal(moved.agents.policy.log_std[0], weights.policy.log_std)
