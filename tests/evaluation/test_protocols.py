"""Evaluations by name: their number is the source's, and what says otherwise is refused."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_runs import tiny_maesn, tiny_settings

from maesn import cli
from maesn.api import adapt
from maesn.evaluation.adapting import _DEPLOYED, _START, _task_keys
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.protocols import PROTOCOLS
from maesn.reporting.reading import MEASURES
from maesn.runs.run import Run
from maesn.storage import RunError
from maesn.studies.reading import read_study
from maesn.worlds.collector import Collector

ML1 = "metaworld-ml1"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    directory = tmp_path_factory.mktemp("protocols") / "run"
    return Run.create(directory, tiny_maesn(), tiny_settings())


def test_the_protocol_of_ml1_is_that_of_meta_world(run: Run) -> None:
    """As its documentation has it: ten episodes, one update, three episodes, success at any step.

    The goals are large here, so that some episodes reach them by chance.
    """
    done = adapt(run, protocol=ML1, sparse_radius=1.4)
    learner = run.learner.fast_learner(run.latest_state())
    world = run.world(run.task_set("test"), "dense", sparse_radius=1.4)
    slots, reached = np.arange(40), []
    state = learner.init(_task_keys(0, _START, slots))
    ten = Collector(world, 10)(_task_keys(0, 0, slots), learner.agents(state), jnp.asarray(slots))
    state = learner.update(state, ten)
    fresh = jax.vmap(jax.random.fold_in, (0, None))(_task_keys(0, 1, slots), np.uint32(_DEPLOYED))
    agents = replace(learner.agents(state, "deploy"), is_noisy=False)
    three = Collector(world, 3)(fresh, agents, jnp.asarray(slots), 1)
    for goal in np.asarray(three.solved & three.valid):
        reached += [any(episode) for episode in goal]
    assert len(reached) == 120
    assert 0 < np.mean(reached) < 1
    found = done.curves.success_rate
    np.testing.assert_allclose(found[:, -1].mean(), np.mean(reached), rtol=1e-6)
    assert np.isnan(found[:, 0]).all()  # it judges nothing before


def test_tables_and_records_name_it(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    table, directory = run.directory / "table.csv", str(run.directory)
    assert cli.run(["adapt", directory, "--protocol", ML1, "--out", str(table)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "After 10 episodes in each of 40 tasks: reaches goal (%)" in said
    assert "deployed agent, by the protocol `metaworld-ml1`." in said
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert {(row["protocol"], row["purpose"]) for row in rows} == {
        (ML1, "explore"),
        (ML1, "deploy"),
    }
    record = json.loads(table.with_suffix(".settings.json").read_text())
    wanted = {"protocol": ML1, "measure": "success_rate", "episodes": 10, "num_tasks": 40}
    assert wanted.items() <= record.items()
    assert record["world"]["reward_kind"] == "dense"
    other = ["--tasks", "validation", "--episodes-per-update", "5"]
    assert cli.run(["adapt", directory, "--protocol", ML1, *other]) == 0
    capsys.readouterr()
    for wrong, said in {
        f"{ML1} --reward sparse": "`reward` is dense by the protocol `metaworld-ml1`, got sparse",
        "ml2": "'varibad' or 'metaworld-ml1', got 'ml2'",
    }.items():
        assert cli.run(["adapt", directory, "--protocol", *wrong.split()]) == cli.USAGE_ERROR
        assert said in capsys.readouterr().err


@pytest.mark.parametrize("name", PROTOCOLS)
def test_every_protocol_is_an_evaluation(name: str, tmp_path: Path) -> None:
    asked = Evaluation().changed(protocol=name)
    assert {x: getattr(asked, x) for x in PROTOCOLS[name].settings()} == PROTOCOLS[name].settings()
    assert PROTOCOLS[name].measure in MEASURES
    assert Evaluation("validation").changed(protocol=name).tasks == "validation"
    with pytest.raises(RunError, match=r"`deploy_episodes` is .* got 7: leave out"):
        Evaluation(deploy_episodes=7).changed(protocol=name)
    text = f"family = 'point'\nruns.maesn = {{}}\nevaluations.its = {{ protocol = '{name}' }}"
    (tmp_path / "mine.toml").write_text(text)
    assert read_study(tmp_path / "mine.toml").evaluations["its"].usual == asked
    (tmp_path / "mine.toml").write_text(text.replace("' }", "', deploy_episodes = 7 }"))
    with pytest.raises(
        RunError, match=r"`evaluations.its`: `deploy_episodes` is .* got 7: leave out"
    ):
        read_study(tmp_path / "mine.toml")
