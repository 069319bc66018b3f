"""Every preset against the protocol of meta-learners, on a tiny analytic world."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from learning_problems.analytic import ACTION, OBSERVATION, AnalyticCollect
from learning_problems.prepared import HORIZON

from maesn import GradientMetaLearner
from maesn.context import AbstractContextSettings, LatentContext, NoContext, OracleContext
from maesn.inner.adaptation import Adaptation, InnerStep
from maesn.learners import PRESETS, Problem
from maesn.learners.gradient.fast_learner import GradientFastState
from maesn.learners.gradient.info import GradientInfo
from maesn.learners.gradient.meta_learner import GradientState
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.policies import GaussianMLP
from maesn.serialization import replaced

TASKS, META_BATCH, STEPS = 7, 3, 4
# A linear policy, because it compiles faster.
SMALL = {
    "policy": GaussianMLP(()),
    "meta_batch_size": META_BATCH,
    "outer": TrustRegionOuterStep(curvature_stride=2, hessian_stride=2),
}
# Those that infer or remember have tests of their own (`test_pearl`, `test_varibad`,
# `test_recurrent`). The slots of the mixtures appear in MAML and in MAESN.
MIXTURES = ("maesn_theta", "maml_bias", "maml_bias_only")
every_preset = pytest.mark.parametrize(
    "preset",
    [
        pytest.param(name, marks=[pytest.mark.long] if name in MIXTURES else [])
        for name in PRESETS
        if not name.startswith(("rl2", "pearl", "varibad"))
    ],
)


@contextmanager
def compilations() -> Iterator[list[str]]:
    """Collect the names of all programs that JAX compiles meanwhile."""
    names: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            message = record.getMessage()
            if message.startswith("Compiling "):
                names.append(message.split()[1])

    listener, logger = Listener(), logging.getLogger("jax")
    logger.addHandler(listener)
    try:
        with jax.log_compiles(True):
            yield names
    finally:
        logger.removeHandler(listener)


class Run(NamedTuple):
    """A few meta-iterations and one adaptation of one preset."""

    collect: AnalyticCollect
    states: list[GradientState]
    infos: list[GradientInfo]
    compiled: list[list[str]]
    """Programs that were compiled in each meta-iteration, and in each fast update."""
    fast_states: list[GradientFastState]
    fast_compiled: list[list[str]]


@cache
def run(preset: str) -> Run:
    learner = PRESETS[preset](**SMALL)
    result = Run(AnalyticCollect(TASKS), [], [], [], [], [])
    result.states.append(learner.init(jax.random.key(0), Problem(OBSERVATION, ACTION, TASKS)))
    for step in range(STEPS):
        with compilations() as names:
            state, info = learner.step(jax.random.key(step), result.states[-1], result.collect)
        result.states.append(state)
        result.infos.append(info)
        result.compiled.append(names)
    fast = learner.fast_learner(result.states[-1])
    result.fast_states.append(fast.init(jax.random.split(jax.random.key(0), TASKS)))
    unseen = AnalyticCollect(TASKS)
    for step in range(STEPS):
        keys = jax.random.split(jax.random.key(step), TASKS)
        with compilations() as names:
            agents = fast.agents(result.fast_states[-1])
            episodes = unseen(keys, agents, jnp.arange(TASKS))
            result.fast_states.append(fast.update(result.fast_states[-1], episodes))
        result.fast_compiled.append(names)
    return result


@every_preset
def test_states_keep_structure_shapes_and_types_and_infos_are_finite_scalars(preset: str) -> None:
    done = run(preset)
    leaves = jax.tree.leaves((done.states, done.infos, done.fast_states))
    assert all(isinstance(leaf, jax.Array) for leaf in leaves)
    for states in (done.states, done.fast_states[1:]):
        kinds = [jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), state) for state in states]
        assert all(kind == kinds[0] for kind in kinds)
    for info in done.infos:
        assert all(leaf.shape == () and np.isfinite(leaf) for leaf in jax.tree.leaves(info))
    assert [int(state.iteration) for state in done.states] == list(range(STEPS + 1))
    assert [int(state.update) for state in done.fast_states] == list(range(STEPS + 1))


@every_preset
def test_parameters_stay_finite_and_change(preset: str) -> None:
    done = run(preset)
    for before, after, info in zip(done.states, done.states[1:], done.infos, strict=False):
        new, old = (jax.tree.leaves(state.parameters) for state in (after, before))
        assert all(np.isfinite(leaf).all() for leaf in new)
        changed = any((x != y).any() for x, y in zip(new, old, strict=True))
        assert changed == bool(info.outer.accepted)
    assert any(info.outer.accepted for info in done.infos)


@every_preset
def test_accepted_steps_lower_the_loss_within_the_trust_region(preset: str) -> None:
    steps = [info.outer for info in run(preset).infos if info.outer.accepted]
    assert steps
    for step in steps:
        assert step.loss_after < step.loss_before
        assert 0 < step.kl < 0.01


@every_preset
def test_shares_of_the_step_sum_to_one(preset: str) -> None:
    for info in run(preset).infos:
        total = info.shares.policy + info.shares.context + info.shares.step_sizes
        np.testing.assert_allclose(total, 1.0 if info.outer.accepted else 0.0, rtol=1e-5)


@every_preset
def test_nothing_is_compiled_after_the_first_step(preset: str) -> None:
    done = run(preset)
    assert "jit(_call)" in done.compiled[0]
    assert not [name for names in done.compiled[1:] for name in names]


@every_preset
def test_fast_updates_are_compiled_once(preset: str) -> None:
    done = run(preset)
    assert "jit(update)" in done.fast_compiled[0]
    # Adapting theta gives each task its own copy in the first update: one program more.
    shared = [state.agents.shares_policy for state in done.fast_states[:2]]
    first = 1 if shared[0] == shared[1] else 2
    assert not [name for names in done.fast_compiled[first:] for name in names]


@every_preset
def test_tasks_are_drawn_without_replacement(preset: str) -> None:
    index = np.stack(run(preset).collect.index)
    assert index.shape == (2 * STEPS, META_BATCH)
    assert all(len(set(row)) == META_BATCH for row in index)
    assert index.min() >= 0
    assert index.max() < TASKS
    # Both collections of a meta-iteration play the same tasks, and the next one plays others.
    np.testing.assert_array_equal(index[::2], index[1::2])
    assert len({tuple(row) for row in index}) > 1


@pytest.mark.parametrize("preset", ["maesn", "maesn_theta", "latent_space"])
def test_latents_that_were_not_played_stay(preset: str) -> None:
    done = run(preset)
    played = done.collect.index[0]
    left_out = np.setdiff1d(np.arange(TASKS), played)
    before, after = (state.parameters.context_table for state in done.states[:2])
    for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(old[left_out], new[left_out])
        assert (old[played] != new[played]).any(axis=-1).all()


def test_the_stage_of_theta_changes_nothing_at_once_and_then_learns() -> None:
    waiting = PRESETS["maesn_theta"](**SMALL)
    joining = replaced(waiting, {"adaptation.policy.first_iteration": 1})
    collect, states = AnalyticCollect(TASKS), []
    state = waiting.init(jax.random.key(0), Problem(OBSERVATION, ACTION, TASKS))
    state, _ = waiting.step(jax.random.key(0), state, collect)
    returns = []
    for learner in (waiting, joining):
        after, info = learner.step(jax.random.key(1), state, collect)
        states.append(after)
        returns.append(float(info.return_after))
    assert returns[0] == returns[1]
    still, learned = (jax.tree.leaves(state.parameters.step_sizes.policy) for state in states)
    assert all((size == 0).all() for size in still)
    assert all((size != 0).any() for size in learned)


def test_a_stride_beyond_the_horizon_leaves_some_curvature() -> None:
    # Without any step to take the curvature of, no candidate is ever acceptable.
    learner = PRESETS["maesn"](
        **SMALL | {"outer": TrustRegionOuterStep(curvature_stride=HORIZON + 4)}
    )
    state = learner.init(jax.random.key(0), Problem(OBSERVATION, ACTION, TASKS))
    _, info = learner.step(jax.random.key(0), state, AnalyticCollect(TASKS))
    assert info.outer.accepted


@pytest.mark.parametrize(
    ("name", "decides"), [("maml", True), pytest.param("maesn", False, marks=pytest.mark.long)]
)
def test_the_hessian_has_a_stride_of_its_own(name: str, decides: bool) -> None:
    outer = replace(SMALL["outer"], hessian_stride=1)
    learner, done = PRESETS[name](**SMALL | {"outer": outer}), run(name)
    after, _ = learner.step(jax.random.key(0), done.states[0], AnalyticCollect(TASKS))
    exact, thinned = (
        np.asarray(ravel_pytree(state.parameters.policy)[0]) for state in (after, done.states[1])
    )
    assert np.allclose(exact, thinned, rtol=1e-4, atol=1e-5) != decides


def test_fewer_tasks_than_a_meta_batch_are_refused() -> None:
    with pytest.raises(ValueError, match=r"`meta_batch_size` is 20, .* only 19 tasks"):
        PRESETS["maesn"]().init(jax.random.key(0), Problem(OBSERVATION, ACTION, 19))


@pytest.mark.parametrize("context", [NoContext(), OracleContext()], ids=["none", "oracle"])
def test_a_context_in_which_nothing_moves_is_given_no_steps(
    context: AbstractContextSettings,
) -> None:
    name = type(context).__name__
    with pytest.raises(ValueError, match=f"`adaptation.context` must be None with {name}, in"):
        GradientMetaLearner(context, Adaptation(context=InnerStep(1.0)))


def test_inner_updates_that_move_nothing_are_refused() -> None:
    with pytest.raises(ValueError, match="`inner_updates` is 1, but `adaptation` moves nothing"):
        GradientMetaLearner(LatentContext(), Adaptation())
    assert GradientMetaLearner(LatentContext(), Adaptation(), inner_updates=0).inner_updates == 0
