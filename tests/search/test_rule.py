"""The rule `search`, from the command line to the table, and what it refuses."""

import json
import math
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from small_runs import tiny_maesn, tiny_settings

import maesn
from maesn import api, cli, latent_space, maesn_theta, maml
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.film import record_adaptation
from maesn.evaluation.running import new_tasks
from maesn.inner.adaptation import Adaptation, InnerStep
from maesn.policies import GaussianMLP
from maesn.rules import SearchRule
from maesn.runs.checkpoint import read_checkpoint, save_checkpoint
from maesn.runs.run import Run
from maesn.runtime import Explorer, facts
from maesn.runtime.return_model import NOMINAL
from maesn.search import stored
from maesn.search.prior import PriorSettings
from maesn.search.stored import read_prior, run_prior
from maesn.storage import RunError
from maesn.worlds.collector import Collector
from maesn.worlds.device import DeviceWorld

SMALL = ["--draws", "10", "--episodes", "2", "--searches", "3", "--simulations", "20"]
FILE = "priors/sparse-0.5.safetensors"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("search") / "run"
    Run.create(directory, tiny_maesn(), tiny_settings())
    assert cli.run(["prior", str(directory), *SMALL]) == 0
    return directory


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("goals") / "few.npz"
    np.savez(path, goal=np.float32([[0.0, 2.0], [2.0, 0.0], [-1.0, 1.0]]))
    return str(path)


def adapted(run: Path, few: str, *more: str) -> int:
    return cli.run(["adapt", str(run), "--rule", "search", "--tasks", few, *more])


def test_the_prior_says_what_training_tasks_return(trained: Path) -> None:
    prior, bound = read_prior(trained / FILE)
    tasks = len(Run.open(trained).training_tasks)
    assert prior.latents.shape == (10 + tasks, 2)
    assert prior.excess.shape == (tasks, 10 + tasks)
    # An untrained point hardly ever reaches a goal, and 40 steps cost at most 0.1 each.
    assert prior.excess.min() >= -4
    assert -4 < np.median(prior.excess) < 0
    assert prior.offset_mean == pytest.approx(-2.0 * 40, rel=1e-3)
    assert set(bound) == {"checkpoint", "training task set", "reward", "action noise", "numbers"}


def test_a_prior_without_levels_as_they_once_were_is_read(trained: Path, tmp_path: Path) -> None:
    values, metadata = read_checkpoint(trained / FILE)
    numbers = json.loads(metadata["numbers"])
    kept = {name: x for name, x in numbers.items() if not name.endswith("levels")}
    save_checkpoint(tmp_path / "older", values, metadata | {"numbers": json.dumps(kept)})
    older = read_prior(tmp_path / "older")[0]
    assert older.proposed_levels == older.deployed_levels == NOMINAL


def test_a_prior_plays_no_more_episodes_at_once_than_the_world_can_hold(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tasks adapt in parts then, to the same latents."""
    run, settings, played = Run.open(trained), PriorSettings(draws=60, episodes=2, searches=0), []
    whole = run_prior(run, settings, directory=tmp_path / "whole")[1]
    play = DeviceWorld.play

    def counted(self: DeviceWorld, act: Any, actors: Any, start: Any) -> Any:
        played.append(math.prod(actors.noise.shape[:2]))
        return play(self, act, actors, start)

    monkeypatch.setattr(DeviceWorld, "max_simulations", 50)
    monkeypatch.setattr(DeviceWorld, "play", counted)
    parts = run_prior(run, settings, directory=tmp_path / "parts")[1]
    assert max(played) == 50
    np.testing.assert_allclose(parts.latents, whole.latents, rtol=1e-5, atol=1e-5)


def test_one_episode_is_one_update_and_fresh_episodes_judge(
    trained: Path, few: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "table.csv"
    options = ["--episodes", "4", "--deploy-episodes", "2", "--out", str(table)]
    assert adapted(trained, few, *options, "--deploy-after", "0", "2", "4") == 0
    shown = capsys.readouterr().out
    assert "fresh episodes" in shown
    rows = [line.split(",") for line in table.read_text().splitlines()[1:]]
    explored = [row[1:3] for row in rows if row[3] == "explore" and row[0] == "0"]
    assert explored == [["0", "0"], ["1", "1"], ["2", "2"], ["3", "3"], ["4", "4"]]
    assert [row[1] for row in rows if row[3] == "deploy" and row[0] == "0"] == ["0", "2", "4"]
    record = json.loads(table.with_suffix(".settings.json").read_text())
    assert record["rule"].startswith("SearchRule(")
    assert record["episodes_per_update"] == 1
    latents = np.load(table.with_suffix(".latents.npz"))["mean"]
    assert latents.shape == (3, 5, 2)


def test_tasks_do_not_depend_on_how_many_there_are(trained: Path, few: str, tmp_path: Path) -> None:
    ask = Evaluation(few, rule=SearchRule(), episodes=3, deploy_episodes=1)
    three = api.adapt(trained, ask, out=tmp_path / "a.csv")
    two = api.adapt(trained, ask.changed(tasks_at_once=1), out=tmp_path / "b.csv", num_tasks=2)
    for name in ("mean_return", "success_rate"):
        found = getattr(two.outcome.deployed, name)
        np.testing.assert_allclose(found, getattr(three.outcome.deployed, name)[:2], rtol=1e-5)


def test_a_missing_prior_is_made_and_said(
    few: str,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Twenty searches, which the fixture `trained` does with three.
    monkeypatch.setattr(stored, "calibrated", lambda prior, *_: prior)
    learner = latent_space(policy=GaussianMLP((8,)), meta_batch_size=2)
    run = Run.create(tmp_path / "run", learner, tiny_settings())
    path = run.directory / FILE
    assert adapted(run.directory, few, "--episodes", "1", "--deploy-episodes", "1") == 0
    assert f"`{path}` is missing." in caplog.text
    latents = read_prior(path)[0].latents
    # The cheaper command works as printed.
    command = caplog.text.split("type: maesn ")[1].splitlines()[0]
    assert cli.run(shlex.split(command)) == 0
    assert len(read_prior(path)[0].latents) == 100 < len(latents)


def test_a_method_that_also_moves_its_weights_searches_with_those_of_training(
    few: str, tmp_path: Path
) -> None:
    both = Adaptation(policy=InnerStep(0.1), context=InnerStep(1.0))
    learner = maesn_theta(adaptation=both, policy=GaussianMLP((8,)), meta_batch_size=2)
    run = Run.create(tmp_path / "run", learner, tiny_settings(method="maesn_theta"))
    assert cli.run(["prior", str(run.directory), *SMALL]) == 0
    ask = Evaluation(few, rule=SearchRule(), episodes=3, deploy_episodes=1)
    outcome = api.adapt(run, ask).outcome
    with new_tasks(run, ask) as (_, searching):
        agents = searching.agents(searching.init(jax.random.split(jax.random.key(0), 3)))
    assert agents.shares_policy
    trained_policy = run.latest_state().parameters.policy
    jax.tree.map(np.testing.assert_array_equal, agents.policy, trained_policy)
    prior, _ = read_prior(run.directory / FILE)
    first = outcome.contexts.mean[:, 0]
    assert (prior.latents[:, None] == first).all(axis=-1).any(axis=0).all()


def test_an_exported_search_is_the_run_s(trained: Path, tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    assert cli.run(["export", str(trained), str(path), "--rule", "search", "draws=0"]) == 0
    explorer = Explorer.load(path, seed=0)
    prior, _ = read_prior(trained / FILE)
    assert explorer.exported.search is not None
    assert explorer.exported.search.settings.draws == 0
    np.testing.assert_array_equal(explorer.exported.search.prior.excess, prior.excess)
    assert dict(facts(explorer.exported))["z"].endswith(f"archive has {len(prior.latents)} latents")
    z = explorer.begin_episode()
    assert (prior.latents == z).all(axis=1).any()


@pytest.mark.parametrize("what", ["checkpoint", "training task set", "reward", "damaged"])
def test_a_prior_of_something_else_or_a_damaged_one_is_refused(
    what: str, trained: Path, few: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = shutil.copytree(trained, tmp_path / "run") / FILE
    if what == "damaged":
        path.write_bytes(path.read_bytes()[:-9] + b"?" + path.read_bytes()[-8:])
    else:
        values, metadata = read_checkpoint(path)
        save_checkpoint(path, values, metadata | {what: "another"})
    assert adapted(tmp_path / "run", few, "--episodes", "1") == 2
    assert what in capsys.readouterr().err


def test_a_prior_for_another_radius_is_used_when_that_is_asked_for(
    trained: Path, few: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    prior = str(trained / FILE)
    wider = ["--sparse-radius", "0.9", "--episodes", "1", "--out", str(tmp_path / "table.csv")]
    rule = ["adapt", str(trained), "--tasks", few, "--deploy-episodes", "1", "--rule", "search"]
    assert cli.run([*rule, f"prior={prior}", *wider]) == 2
    said = capsys.readouterr().err
    assert "was made for another reward" in said
    assert "leave out `prior`, for the run's own, or allow it by `any_reward=true`" in said
    assert cli.run([*rule, f"prior={prior}", "any_reward=true", *wider]) == 0


def test_what_makes_no_sense_is_one_sentence(
    trained: Path, few: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert adapted(trained, few, "--episodes", "0") == 2
    assert "`episodes`" in capsys.readouterr().err
    without = tmp_path / "without"
    Run.create(without, maml(policy=GaussianMLP((8,)), meta_batch_size=2), tiny_settings())
    assert adapted(without, few) == 2
    assert "a search needs a policy with a latent" in capsys.readouterr().err
    assert cli.run(["prior", str(without)]) == 2
    assert "`maml` cannot search" in capsys.readouterr().err
    assert cli.run(["adapt", str(trained), "--rule", "search", "acquisition=best"]) == 2
    assert "acquisition" in capsys.readouterr().err
    control = ["export", str(trained), str(tmp_path / "policy.npz"), "--rule", "stationary"]
    assert cli.run(control) == 2
    assert "`rule` must be `gradient`, or `search`" in capsys.readouterr().err


def test_one_training_task_is_no_prior(tmp_path: Path) -> None:
    np.savez(tmp_path / "one.npz", goal=np.float32([[0.0, 2.0]]))
    settings = tiny_settings(tasks=str(tmp_path / "one.npz"))
    run = Run.create(tmp_path / "run", tiny_maesn(meta_batch_size=1), settings)
    with pytest.raises(RunError, match="trained on one task"):
        maesn.prior(run)


def test_an_update_of_four_episodes_plays_four_latents_that_were_proposed_together(
    trained: Path, few: str
) -> None:
    run, ask = Run.open(trained), Evaluation(few, rule=SearchRule(), episodes=8)
    ask = ask.changed(episodes_per_update=4, deploy_episodes=1)
    with new_tasks(run, ask) as (world, learner):
        collect = Collector(world, 4)
        keys = jax.random.split(jax.random.key(0), 3)
        state = learner.init(keys)
        episodes = collect(keys, learner.agents(state), jax.numpy.arange(3))
        after = learner.update(state, episodes)
    for task, (search, points) in enumerate(zip(state.searches, state.chosen, strict=True)):
        assert len(set(points)) == 4
        np.testing.assert_allclose(episodes.z[task], search.points[list(points)], rtol=1e-6)
        readings = after.searches[task].posterior.readings
        assert tuple(one.point for one in readings) == points
        returns = [one.episode_return for one in readings]
        np.testing.assert_allclose(returns, episodes.undiscounted_return[task], rtol=1e-5)
    assert learner.agents(after, "deploy").context.mean.shape == (3, 2)


@pytest.mark.parametrize("action_noise", [False, True])
@pytest.mark.parametrize("rule", [SearchRule(), None])
def test_the_latent_explores_and_not_the_actions_unless_that_is_asked_for(
    rule: SearchRule | None,
    action_noise: bool,
    trained: Path,
    few: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    noisy: dict[int, set[bool]] = {2: set(), 3: set()}  # by episodes of a call: explore, deploy
    play = Collector.__call__

    def watched(self: Collector, keys: Any, agents: Any, *more: Any) -> Any:
        noisy[self.episodes_per_task].add(agents.is_noisy)
        return play(self, keys, agents, *more)

    run = shutil.copytree(trained, tmp_path / "run")
    if rule is not None and action_noise:  # the run has a prior without noise
        assert cli.run(["prior", str(run), *SMALL, "--action-noise", "True"]) == 0
    monkeypatch.setattr(Collector, "__call__", watched)
    ask = Evaluation(few, rule=rule, episodes=2, episodes_per_update=2, deploy_episodes=3)
    ask = ask.changed(action_noise=action_noise)
    api.adapt(run, ask, out=tmp_path / "table.csv")
    with new_tasks(Run.open(run), ask) as (world, learner):  # a film shows the same
        record_adaptation(learner, world, ask, 0, [0], 1)
    assert noisy == {2: {action_noise or rule is None}, 3: {action_noise}}


def test_without_noise_a_prior_plays_a_latent_once_and_learns_the_noise_from_a_few(
    tmp_path: Path,
) -> None:
    run = Run.create(tmp_path / "run", tiny_maesn(), tiny_settings())
    settings = PriorSettings(draws=30, adapted=False, episodes=1, searches=0)
    _, prior = run_prior(run, settings)
    assert prior.episodes == 1
    assert len(set(prior.noise)) == 1
    again = run_prior(run, replace(settings, episodes=4))[1]
    assert 0.5 < prior.noise[0] / again.noise.mean() < 2.0
