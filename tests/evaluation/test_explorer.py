"""What is recorded for the report page: paths of latents, and searches."""

from contextlib import closing
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special
from small_runs import create, tiny_maesn

from maesn import maml, varibad
from maesn.evaluation import exploration
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import evaluate
from maesn.learners.varibad.decoder import BeliefDecoderSettings
from maesn.policies import CategoricalMLP, GaussianMLP
from maesn.reporting.runs import (
    BELIEF,
    EXPLORATION,
    LATENT_PATHS,
    SEARCHES,
    RecordedExploration,
    read_recorded,
)
from maesn.rules import SearchRule
from maesn.runs.run import Run
from maesn.search.prior import PriorSettings
from maesn.search.stored import find_prior, run_prior
from maesn.worlds.collector import Collector


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run with a prior over returns, and what is recorded of it."""
    made = create(tmp_path_factory.mktemp("explorer") / "run", tiny_maesn())
    run_prior(made, PriorSettings(draws=12, adapted=False, episodes=2, searches=0))
    exploration.record_explorer(made)
    return made


def test_latents_are_a_lattice_in_the_plane_and_draws_beyond() -> None:
    line, plane, space = (exploration.spread_latents(size) for size in (1, 2, 3))
    assert (line.shape, plane.shape, space.shape) == ((441, 1), (441, 2), (441, 3))
    assert len(np.unique(plane[:, 0])) == len(np.unique(plane[:, 1])) == 21
    assert len(np.unique(plane, axis=0)) == 441
    np.testing.assert_array_equal(space, exploration.spread_latents(3))
    assert np.abs(space).max() <= np.abs(plane).max()


def test_each_latent_has_the_path_of_an_episode(run: Run) -> None:
    paths = np.load(run.directory / LATENT_PATHS)["paths"]
    assert paths.shape == (441, 40, 2)
    # The point starts at the origin, up to its noise of 1 cm, and moves at most 10 cm in a step.
    assert np.abs(paths[:, 0]).max() < 0.1
    steps = np.linalg.norm(np.diff(paths, axis=1), axis=-1)
    assert steps.max() <= 2 * np.sqrt(2) * 0.1 + 1e-5
    assert not np.allclose(paths[0], paths[-1], atol=1e-3)


def test_searches_are_those_of_the_rule(run: Run) -> None:
    recorded = np.load(run.directory / SEARCHES)
    assert {name: recorded[name].shape for name in recorded} == {
        "task": (8,),
        "edge": (),
        "played": (8, 10, 2),
        "returns": (8, 10),
        "reached": (8, 10),
        "paths": (8, 10, 40, 2),
        "deployed": (8, 11, 2),
        "mean": (8, 11, 21, 21),
        "std": (8, 11, 21, 21),
        "interval": (8, 11, 2),
        "familiar": (8, 11),
    }
    with closing(run.world(reward_kind="sparse")) as world:
        prior = find_prior(run, run.latest_state(), world.env, action_noise=False)
    model = SearchRule().settings.model(prior)
    first = exploration.LatentSearch.start(model, SearchRule().settings)
    means = first.posterior.mean
    np.testing.assert_allclose(
        recorded["deployed"][:, 0], np.tile(first.points[np.argmax(means)], (8, 1)), atol=1e-5
    )
    assert (recorded["std"] >= 0).all()
    # Beliefs are those of the model at the corners of the square.
    corner = np.array([[-recorded["edge"], -recorded["edge"]]])
    more = first.posterior.extended(corner)
    np.testing.assert_allclose(recorded["mean"][:, 0, 0, 0], more.mean[-1], rtol=1e-5)
    assert set(np.unique(recorded["reached"])) <= {0.0, 1.0}


def test_a_search_of_an_earlier_prior_is_not_shown(tmp_path: Path) -> None:
    made = create(tmp_path / "run", tiny_maesn())
    (made.directory / SEARCHES).parent.mkdir()
    (made.directory / SEARCHES).touch()
    exploration.record_explorer(made)
    assert not (made.directory / SEARCHES).exists()


def test_a_record_is_of_the_weights_that_played(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Meanwhile a training may have gone on."""
    played = run.latest_state()
    later = jax.tree.map(lambda x: x + 1, played)
    states = iter([played, later, later])
    monkeypatch.setattr(Run, "latest_state", lambda self: next(states))
    asked = Evaluation(num_tasks=2, episodes=3, episodes_per_update=3)
    assert evaluate(run, asked)[1]["weights"] == run.identity(played)["weights"]
    assert run.identity(played) != run.identity(later)


def test_a_family_may_have_fewer_tasks_than_searches_are_shown_of(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exploration, "_TASKS", 101)  # more than the 100 of `point`
    monkeypatch.setattr(exploration, "_EPISODES", 1)
    recorded = exploration._searches(run)
    assert len(recorded["task"]) == len(recorded["returns"]) == 100


def test_a_belief_is_that_of_the_agent_and_predicts_cell_by_cell(tmp_path: Path) -> None:
    """The decoder's last layer is set to a chance of its own in every cell, whatever the belief."""
    decoder = BeliefDecoderSettings((4,), "bernoulli", (5, 5))
    learner = varibad(policy=CategoricalMLP((4,)), decoder=decoder, meta_batch_size=4)
    with pytest.warns(UserWarning, match="every set is all of them"):
        made = create(tmp_path / "run", learner, family="grid_navi")
    chances = np.random.default_rng(0).uniform(0.1, 0.9, (5, 5)).astype(np.float32)
    state = eqx.tree_at(
        lambda one: (
            one.networks.decoder.reward.layers[-1].weight,
            one.networks.decoder.reward.layers[-1].bias,
        ),
        made.latest_state(),
        (jnp.zeros((4, 25)), jnp.asarray(scipy.special.logit(chances)).ravel()),
    )
    tasks, keys = made.task_set("test"), jax.random.split(jax.random.key(1), 2)
    fast = learner.fast_learner(state)
    with closing(made.world(tasks)) as world:
        collect = Collector(world, 1)
        states, played = exploration._play_on(fast, collect, keys, jnp.array([3, 20]), 2)
    places = np.array([[0.0, 0.0], [3.0, 1.0], [1.3, 3.6]], np.float32)
    belief = learner.belief(state, played, places)
    assert belief.mean.shape == (2, 31, 5)
    expected = chances[[0, 3, 1], [0, 1, 4]]
    np.testing.assert_allclose(belief.predicted, np.broadcast_to(expected, (2, 31, 3)), rtol=1e-4)
    for moment, trial in ((0, states[0]), (15, states[1]), (30, states[2])):
        policy = state.networks.policy
        hidden = policy.encoder.initial()[None] if trial is None else trial.recurrent_state.hidden
        after = jax.vmap(policy.encoder.posterior)(hidden.reshape(-1, hidden.shape[-1]))
        found = np.stack([belief.mean[:, moment], belief.std[:, moment]])
        np.testing.assert_allclose(
            found, np.broadcast_to(np.stack([after.mean, after.std()]), found.shape), atol=1e-5
        )
    exploration.record_belief(made)
    recorded = np.load(made.directory / BELIEF)
    assert {name: recorded[name].shape for name in recorded} == {
        "task": (),
        "step": (31,),
        "mean": (31, 5),
        "std": (31, 5),
        "predicted": (31, 15, 15),
        "corners": (2, 2),
        "paths": (2, 16, 2),
    }
    np.testing.assert_array_equal(recorded["corners"], [[-0.5, -0.5], [4.5, 4.5]])
    # Three by three places share a cell.
    np.testing.assert_array_equal(
        recorded["predicted"][:, ::3, ::3], recorded["predicted"][:, 2::3, 2::3]
    )


def test_a_run_without_latents_has_none_to_show(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = create(tmp_path / "run", maml(policy=GaussianMLP((8,)), meta_batch_size=4), iterations=1)
    exploration.record_explorer(made)
    exploration.record_belief(made)
    for file in (BELIEF, LATENT_PATHS, SEARCHES):
        assert not (made.directory / file).exists()
    monkeypatch.setattr(exploration, "EXPLORATION_EPISODES", 5)
    exploration.record_exploration(made, made.directory / EXPLORATION)
    recorded = read_recorded(RecordedExploration, made.directory / EXPLORATION)
    assert recorded is not None
    assert recorded.prior_paths.shape == recorded.untrained_paths.shape == (5, 41, 2)
    assert recorded.fixed_paths is None
    assert recorded.prior_latents is None
