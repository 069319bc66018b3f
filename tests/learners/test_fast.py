"""Adaptation to new tasks against the reference's inner update, step by step."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from learning_problems.prepared import LATENT, UNEQUAL, make_problem, play, stack
from learning_problems.translation import learner_for, to_library
from playing import keys
from reference.advantage import experience
from reference.maesn import Agent, inner_update, start

from maesn.context import Latent
from maesn.learners import GradientFastLearner, GradientState
from maesn.learners.presets import latent_space

TASKS = 3
pytestmark = pytest.mark.usefixtures("x64", "quick_compiler")


def fast_learner(preset: str) -> GradientFastLearner:
    problem = make_problem(2, UNEQUAL)
    learner = learner_for(problem)
    if preset == "latent_space":
        settings = latent_space()
        learner = replace(learner, adaptation=settings.adaptation, schedule=settings.schedule)
    return learner.fast_learner(GradientState(to_library(problem.parameters), jnp.zeros((), int)))


@pytest.mark.parametrize(
    ("preset", "scales"),
    [
        ("maesn", [1, 1, 1 / 2, 1 / 4, 1 / 8]),
        ("latent_space", [1, 1, 1, 1 / 2, 1 / 4]),
    ],
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
    np.testing.assert_allclose(
        state.agents.context.mean, [agent.mean for agent in expected], atol=1e-10
    )


def test_theta_and_step_sizes_stay() -> None:
    learner = fast_learner("maesn")
    problem, rng = make_problem(2, UNEQUAL), np.random.default_rng(0)
    theta = start(problem.parameters, 0).theta
    state = learner.init(keys(1))
    moved = learner.update(
        state, stack([play(rng, theta, np.zeros(LATENT), np.zeros(LATENT), UNEQUAL)])
    )
    assert moved.agents.shares_policy
    for old, new in zip(
        jax.tree.leaves(learner.policy), jax.tree.leaves(moved.agents.policy), strict=True
    ):
        np.testing.assert_array_equal(old, new)


def test_adaptation_resumes_where_it_stopped() -> None:
    learner = fast_learner("maesn")
    problem, rng = make_problem(2, UNEQUAL), np.random.default_rng(0)
    theta = start(problem.parameters, 0).theta
    batches = [
        stack([play(rng, theta, np.zeros(LATENT), np.zeros(LATENT), UNEQUAL)]) for _ in range(4)
    ]
    state = learner.init(keys(1))
    for episodes in batches:
        state = learner.update(state, episodes)
    half = learner.init(keys(1))
    for episodes in batches[:2]:
        half = learner.update(half, episodes)
    contexts = learner.contexts(half)
    assert isinstance(contexts, Latent)
    resumed = learner.resume(contexts, update=2)
    for episodes in batches[2:]:
        resumed = learner.update(resumed, episodes)
    for old, new in zip(jax.tree.leaves(state), jax.tree.leaves(resumed), strict=True):
        np.testing.assert_array_equal(old, new)
