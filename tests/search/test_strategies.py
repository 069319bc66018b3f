"""Strategies that search by returns alone, and the rules that are made of them."""

import json
import sys
from contextlib import closing
from pathlib import Path

import cmaes
import jax
import numpy as np
import pytest
from small_runs import tiny_maesn, tiny_settings

from maesn import api, cli
from maesn.evaluation.evaluation import Evaluation
from maesn.rules import (
    AbstractRule,
    BestOfRule,
    CmaEsRule,
    CrossEntropyRule,
    ThenTrpo,
    Trained,
    VimeBonus,
)
from maesn.runs.run import Run
from maesn.search.strategies import LEAST_STD, AbstractStrategy, BestOf, CmaEs, CrossEntropy
from maesn.worlds.collector import Collector

OPTIMUM = np.array([2.0, -1.0])


def played(
    strategy: AbstractStrategy, count: int, seed: int = 0
) -> tuple[AbstractStrategy, np.ndarray, np.ndarray]:
    """Search for the optimum of a quadratic; return the strategy, `[latent, z]` and `[latent]`."""
    generator, latents, returns = np.random.default_rng(seed), [], []
    for _ in range(count):
        latents.append(strategy.proposed(generator))
        returns.append(-float(((latents[-1] - OPTIMUM) ** 2).sum()))
        strategy = strategy.after(latents[-1], returns[-1])
    return strategy, np.stack(latents), np.asarray(returns)


def test_the_best_draw_is_deployed() -> None:
    start = BestOf(np.zeros(2), 3.0)
    np.testing.assert_array_equal(start.deployed, 0.0)
    for count in (1, 7, 200):
        after, latents, returns = played(start, count)
        np.testing.assert_array_equal(after.deployed, latents[returns.argmax()])
    # 400 numbers of N(0, 3^2): the sample standard deviation, to four standard errors.
    assert abs(latents.std() - 3.0) < 4 * 3.0 / np.sqrt(2 * latents.size)


def test_the_next_round_is_fitted_to_the_best_of_this_one() -> None:
    start = CrossEntropy(np.zeros(2), np.full(2, 2.0), round_size=10, elite=0.3)
    early, _, _ = played(start, 9)
    np.testing.assert_array_equal(early.deployed, 0.0)
    after, latents, returns = played(start, 10)
    assert isinstance(after, CrossEntropy)
    best = latents[np.argsort(returns)[-3:]]
    np.testing.assert_allclose(after.mean, best.mean(axis=0))
    np.testing.assert_allclose(after.std, best.std(axis=0) + LEAST_STD)
    assert after.played == ()


def test_cma_es_is_that_of_the_library() -> None:
    start = CmaEs(cmaes.CMA(np.zeros(2), 2.0, seed=0))
    after, latents, returns = played(start, 30)
    plain = cmaes.CMA(np.zeros(2), 2.0, seed=5)
    for first in range(0, 30, 6):
        rows = range(first, first + 6)
        plain.tell([(latents[row], -returns[row]) for row in rows])
    np.testing.assert_allclose(after.deployed, plain.mean)
    np.testing.assert_array_equal(start.deployed, 0.0)  # what came after has not changed it


@pytest.mark.parametrize(
    "start",
    [
        CrossEntropy(np.zeros(2), np.full(2, 2.0), round_size=20, elite=0.2),
        CmaEs(cmaes.CMA(np.zeros(2), 2.0, seed=0)),
    ],
    ids=["cross_entropy", "cma_es"],
)
def test_the_optimum_of_a_quadratic_is_found(start: AbstractStrategy) -> None:
    after, latents, _ = played(start, 300)
    np.testing.assert_allclose(after.deployed, OPTIMUM, atol=0.1)
    again, same, _ = played(start, 300)
    np.testing.assert_array_equal(latents, same)
    np.testing.assert_array_equal(after.deployed, again.deployed)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("strategies") / "run"
    Run.create(directory, tiny_maesn(), tiny_settings())
    return directory


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("goals") / "few.npz"
    np.savez(path, goal=np.float32([[0.0, 2.0], [2.0, 0.0], [-1.0, 1.0]]))
    return str(path)


@pytest.mark.parametrize("name", ["best_of", "cross_entropy round_size=4", "cma_es spread=1"])
def test_a_rule_by_its_name(name: str, trained: Path, few: str, tmp_path: Path) -> None:
    table, budget = tmp_path / "table.csv", ["--episodes", "5", "--deploy-episodes", "2"]
    options = ["--tasks", few, "--out", str(table), *budget, "--deploy-after", "0", "5"]
    assert cli.run(["adapt", str(trained), *options, "--rule", *name.split()]) == 0
    record = json.loads(table.with_suffix(".settings.json").read_text())
    assert record["episodes_per_update"] == 1
    rows = [line.split(",") for line in table.read_text().splitlines()[1:]]
    assert [row[2] for row in rows if row[3] == "deploy" and row[0] == "0"] == ["0", "5"]


def test_the_best_draw_of_a_run_is_deployed_in_every_task(trained: Path, few: str) -> None:
    ask = Evaluation(few, rule=BestOfRule(), episodes=6, deploy_episodes=1)
    outcome = api.adapt(trained, ask).outcome
    found = outcome.contexts.mean  # [task, update, z]
    returns = outcome.explored.mean_return
    for task in range(3):
        best = [returns[task, : count + 1].argmax() for count in range(6)]
        changes = [count for count in range(1, 6) if best[count] != best[count - 1]]
        moved = (found[task, 1:] != found[task, :-1]).any(axis=-1)
        assert [0, *changes] == np.flatnonzero(moved).tolist()


def test_tasks_do_not_depend_on_how_many_there_are(trained: Path, few: str, tmp_path: Path) -> None:
    ask = Evaluation(few, rule=CmaEsRule(), episodes=7, deploy_episodes=1)
    three = api.adapt(trained, ask, out=tmp_path / "a.csv").outcome.contexts
    two = api.adapt(trained, ask.changed(tasks_at_once=1), out=tmp_path / "b.csv", num_tasks=2)
    np.testing.assert_allclose(two.outcome.contexts.mean, three.mean[:2], rtol=1e-5)


def test_cma_es_without_its_library_is_one_sentence(
    trained: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "cmaes", None)
    assert cli.run(["adapt", str(trained), "--rule", "cma_es"]) == 2
    assert "needs the library `cmaes`: pip install -e '.[cmaes]'." in capsys.readouterr().err


@pytest.mark.parametrize("rule", [BestOfRule(), CrossEntropyRule(round_size=2), CmaEsRule()])
def test_fine_tuning_goes_on_from_the_latent_to_deploy(
    rule: AbstractRule, trained: Path, few: str, tmp_path: Path
) -> None:
    alone = api.adapt(trained, tasks=few, rule=rule, episodes=3, out=tmp_path / "a.csv")
    then = (ThenTrpo(after=3), VimeBonus())
    ask = Evaluation(few, rule=rule, wrappers=then, episodes=23, deploy_episodes=1)
    tuned = api.adapt(trained, ask, out=tmp_path / "b.csv").outcome.contexts
    np.testing.assert_array_equal(tuned.mean[:, 3:], tuned.mean[:, [3] * 21])
    if isinstance(rule, BestOfRule):  # without a bonus, the draws and the best of them are these
        ask = ask.changed(wrappers=then[:1])
        tuned = api.adapt(trained, ask, out=tmp_path / "c.csv").outcome.contexts
        found = alone.outcome.contexts.mean
        np.testing.assert_array_equal(tuned.mean[:, 3:], found[:, [3] * 21])
    np.testing.assert_allclose(tuned.log_std, np.log(1e-6), rtol=1e-6)


def test_an_update_leaves_the_state_before_as_it_was(trained: Path) -> None:
    run = Run.open(trained)
    learner = BestOfRule().fast_learner(Trained(run.learner, run.latest_state()), run.env())
    state = learner.init(jax.random.split(jax.random.key(3), 2))
    index = jax.numpy.arange(2)
    with closing(run.world()) as world:
        episodes = Collector(world, 1)(
            jax.random.split(jax.random.key(4), 2), learner.agents(state), index
        )
    first, second = (learner.update(state, episodes) for _ in range(2))
    np.testing.assert_array_equal(first.chosen, second.chosen)


def test_the_same_keys_propose_the_same_latents(trained: Path) -> None:
    run = Run.open(trained)
    trained_as = Trained(run.learner, run.latest_state())
    learner = CrossEntropyRule(round_size=2).fast_learner(trained_as, run.env())
    keys = jax.random.split(jax.random.key(3), 2)
    first, second = learner.init(keys), learner.init(keys[::-1])
    np.testing.assert_array_equal(first.chosen, second.chosen[::-1])
