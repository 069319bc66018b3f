"""The example of own rules: searches by returns alone, named on the command line and in studies."""

import json
from pathlib import Path
from typing import Any

import cmaes
import numpy as np
import own_searches as searches
import pytest
from scripts import ROOT
from small_runs import tiny_maesn, tiny_settings

import maesn
from maesn import api, cli, maml
from maesn.policies import GaussianMLP
from maesn.runs.run import Run
from maesn.storage import RunError

OPTIMUM = np.array([2.0, -1.0])


def played(search: Any, count: int, seed: int = 0) -> tuple[Any, np.ndarray, np.ndarray]:
    """Search for the optimum of a quadratic; return the memory, `[latent, z]` and `[latent]`."""
    generator, memory = np.random.default_rng(seed), search.start(2)
    latents, returns = [], []
    for _ in range(count):
        latents.append(search.propose(memory, generator))
        returns.append(-float(((latents[-1] - OPTIMUM) ** 2).sum()))
        memory = search.after(memory, latents[-1], returns[-1])
    return memory, np.stack(latents), np.asarray(returns)


def test_the_next_round_is_fitted_to_the_best_of_this_one() -> None:
    search = searches.CrossEntropy(spread=2.0, round_size=10, elite=0.3)
    np.testing.assert_array_equal(search.deployed(played(search, 9)[0]), 0.0)
    after, latents, returns = played(search, 10)
    best = latents[np.argsort(returns)[-3:]]
    np.testing.assert_allclose(after.mean, best.mean(axis=0))
    np.testing.assert_allclose(after.std, best.std(axis=0) + search.least_std)
    assert after.played == ()


def test_cma_es_is_that_of_the_library() -> None:
    search = searches.CmaEs(spread=2.0)
    start = search.start(2)
    after, latents, returns = played(search, 30)
    plain = cmaes.CMA(np.zeros(2), 2.0, seed=5)
    for first in range(0, 30, 6):
        rows = range(first, first + 6)
        plain.tell([(latents[row], -returns[row]) for row in rows])
    np.testing.assert_allclose(search.deployed(after), plain.mean)
    np.testing.assert_array_equal(search.deployed(start), 0.0)


@pytest.mark.parametrize("search", [searches.CrossEntropy(spread=2.0), searches.CmaEs(spread=2.0)])
def test_the_optimum_of_a_quadratic_is_found(search: Any) -> None:
    after, latents, _ = played(search, 300)
    np.testing.assert_allclose(search.deployed(after), OPTIMUM, atol=0.1)
    np.testing.assert_array_equal(latents, played(search, 300)[1])


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return Run.create(tmp_path_factory.mktemp("searches") / "run", tiny_maesn(), tiny_settings())


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("goals") / "few.npz"
    np.savez(path, goal=np.float32([[0.0, 2.0], [2.0, 0.0], [-1.0, 1.0]]))
    return str(path)


@pytest.mark.parametrize("name", ["BestOf", "CrossEntropy round_size=4", "CmaEs spread=1"])
def test_a_rule_by_its_name(name: str, trained: Run, few: str, tmp_path: Path) -> None:
    table, budget = tmp_path / "table.csv", ["--episodes", "5", "--deploy-episodes", "2"]
    options = ["--tasks", few, "--out", str(table), *budget, "--deploy-after", "0", "5"]
    rule = ["--rule", *f"own_searches:{name}".split()]
    assert cli.run(["adapt", str(trained.directory), *options, *rule]) == 0
    record = json.loads(table.with_suffix(".settings.json").read_text())
    assert record["rule"].startswith(f"own_searches:{name.split()[0]}(spread=")
    rows = [line.split(",") for line in table.read_text().splitlines()[1:]]
    assert [row[2] for row in rows if row[3] == "deploy" and row[0] == "0"] == ["0", "5"]


def test_the_best_draw_of_a_run_is_deployed_in_every_task(trained: Run, few: str) -> None:
    asked = maesn.Evaluation(few, rule=searches.BestOf(), episodes=6, deploy_episodes=1)
    outcome = api.adapt(trained, asked).outcome
    found = outcome.contexts.mean  # [task, update, z]
    returns = outcome.explored.mean_return
    for task in range(3):
        best = [returns[task, : count + 1].argmax() for count in range(6)]
        changes = [count for count in range(1, 6) if best[count] != best[count - 1]]
        moved = (found[task, 1:] != found[task, :-1]).any(axis=-1)
        assert [0, *changes] == np.flatnonzero(moved).tolist()


@pytest.mark.long
def test_fine_tuning_goes_on_from_the_latent_to_deploy(trained: Run, few: str) -> None:
    added = (maesn.ThenTrpo(after=3), maesn.VimeBonus())
    rule = searches.CrossEntropy(round_size=2)
    asked = maesn.Evaluation(few, rule=rule, wrappers=added, episodes=23, deploy_episodes=1)
    tuned = api.adapt(trained, asked).outcome.contexts
    np.testing.assert_array_equal(tuned.mean[:, 3:], tuned.mean[:, [3] * 21])
    np.testing.assert_allclose(tuned.log_std, np.log(1e-6), rtol=1e-6)


def test_a_method_without_a_latent_is_refused(tmp_path: Path, few: str) -> None:
    learner = maml(policy=GaussianMLP((8,)), meta_batch_size=2)
    run = Run.create(tmp_path / "run", learner, tiny_settings())
    with pytest.raises(RunError, match="a search needs a policy with a latent"):
        api.adapt(run, tasks=few, rule=searches.BestOf())


def test_the_study_that_names_one_can_be_computed() -> None:
    study = maesn.Study.load(ROOT / "examples" / "few_episodes.toml")
    assert [name for name in study.jobs if "crossentropy" in name]
