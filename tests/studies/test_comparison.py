"""Comparisons of runs that exist, on runs that take seconds."""

import csv
from pathlib import Path

import pytest
from inline_executor import Here
from small_runs import create, tiny_maesn

from maesn import cli, oracle
from maesn.envs.sources import resolve_family
from maesn.evaluation.evaluation import Evaluation
from maesn.policies import USUAL, GaussianMLP
from maesn.rules import GradientRule, ThenTrpo
from maesn.storage import read_json
from maesn.studies.comparison import compare
from maesn.studies.members import scratch_learner
from maesn.studies.spec import ScratchSpec

FEW = Evaluation(num_tasks=4, episodes=3, episodes_per_update=3, tasks_at_once=2)
SMALL = {"policy": GaussianMLP((8,)), "meta_batch_size": 4}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    place = tmp_path_factory.mktemp("runs")
    made = {
        "maesn": create(place / "maesn", tiny_maesn()),
        "again": create(place / "again", tiny_maesn(), seed=1),
        "oracle": create(place / "oracle", oracle(**SMALL), iterations=2),
    }
    return {name: run.directory for name, run in made.items()}


@pytest.fixture(autouse=True)
def small_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Methods from scratch with small networks, which compile and run faster."""
    monkeypatch.setitem(USUAL, "continuous", GaussianMLP((4,)))


def table(out: Path) -> list[dict[str, str]]:
    with (out / "comparison" / "results.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.usefixtures("figures_unsaved")
def test_methods_on_the_same_tasks(runs: dict[str, Path], tmp_path: Path) -> None:
    asked = {
        "out": tmp_path,
        "scratch": ["reinforce", "trpo:2"],
        "evaluation": FEW,
        "oracle": runs["oracle"],
        "executor": Here(),
    }
    said: list[str] = []
    done = compare([runs["maesn"], runs["again"]], **asked, say=said.append)
    # Two seeds of a run, two baselines, an oracle and a method, by chunks of two tasks; one of two.
    assert sum("adapt-" in sentence for sentence in said) == 6 * 2 + 1
    manifest = read_json(done.directory / "study.json")
    (one,) = manifest["comparisons"]
    lines = {line["name"]: [seed["seed"] for seed in line["seeds"]] for line in one["lines"]}
    assert lines == {"maesn": [0, 1], "reinforce": [0], "trpo": [0]}
    rows = table(tmp_path)
    counts = {name: sum(row["method"] == name for row in rows) for name in ("maesn", "trpo")}
    assert counts == {"maesn": 2 * 4 * 2, "trpo": 1 * 2 * 2}
    assert {row["steps"] for row in rows} == {"0", str(3 * 40)}
    assert any(row["score"] for row in rows)  # there is an oracle
    again: list[str] = []
    compare([runs["maesn"], runs["again"]], **asked, say=again.append)
    assert not any("/13 adapt" in sentence for sentence in again)
    assert table(tmp_path) == rows


@pytest.mark.usefixtures("figures_unsaved")
def test_runs_take_part_a_second_time_with_what_is_added(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    rule = GradientRule(step_scale=2.0)
    asked = Evaluation(
        num_tasks=2, episodes=40, episodes_per_update=20, rule=rule, wrappers=(ThenTrpo(after=20),)
    )
    said: list[str] = []
    done = compare(
        [runs["maesn"], runs["oracle"]],
        out=tmp_path,
        evaluation=asked,
        executor=Here(),
        say=said.append,
    )
    (one,) = read_json(done.directory / "study.json")["comparisons"]
    labels = [line["label"] for line in one["lines"]]
    assert labels == ["MAESN", "oracle", "MAESN (steps × 2; 20 episodes, then TRPO)"]
    assert [line["addition"] for line in one["lines"]] == [False, False, True]
    assert any("oracle takes part as it is" in sentence for sentence in said)


def test_settings_of_methods_from_scratch_reach_them() -> None:
    env = resolve_family("point").make_env(variant="reference", reward_kind="sparse")

    def learner(method: str, **settings: float) -> object:
        return scratch_learner(ScratchSpec(method, **settings), env)

    assert learner("reinforce", step_size=0.3).improvement.rule.step_size == 0.3
    assert learner("trpo", max_kl=0.07).improvement.rule.trust_region.max_kl == 0.07
    vime = learner("vime", max_kl=0.07, curiosity_weight=0.01)
    assert vime.learner.improvement.rule.trust_region.max_kl == 0.07
    assert vime.curiosity.weight == 0.01
    with pytest.raises(ValueError, match="`trpo` has no `step_size`"):
        learner("trpo", step_size=0.3)
    with pytest.raises(ValueError, match="`reinforce` has no `curiosity`"):
        learner("reinforce", curiosity_weight=0.01)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--scratch trpo --out {0}", "`family` must be given"),
        ("--out {0}", "name at least one run directory, or a method with --scratch"),
        ("--family point --scratch sac --out {0}", "`scratch` must be one of reinforce, vpg, trpo"),
        ("--family point --scratch trop --out {0}", "got `trop`. Did you mean `trpo`?"),
        ("--family point --scratch trpo:x --out {0}", "perhaps as in vime:30, got `trpo:x`"),
        ("--family point --scratch trpo:0 --out {0}", "`num_tasks` must be at least 1, got 0"),
        ("{1} --family wheeled --out {0}", "family is `point`, but `wheeled` was given"),
        ("{1} --episodes 75 --out {0}", "`episodes` must be a multiple of `episodes_per_update`"),
        ("{1} --episodes -50 --out {0}", "`episodes` must be at least 0, got -50"),
        ("{1} --oracle {0} --out {0}", "there is no run in"),
        ("{1} --oracle {1} --out {0}", "must be the only run of the method `oracle`, got `maesn`"),
        ("{2} --oracle {2} --out {0}", "must be the only run of the method `oracle`, got `oracle`"),
        ("{1} --then trpo --out {0}", "must be at least 20 more than `after`, got 500 and 500"),
        ("{1} --seed 4294967296 --out {0}", "`seed` must be at most 4294967295"),
    ],
)
def test_what_cannot_be_compared_is_refused_in_a_sentence(
    runs: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: str,
    message: str,
) -> None:
    command = arguments.format(tmp_path / "out", runs["maesn"], runs["oracle"]).split()
    try:
        code = cli.run(["compare", *command])
    except SystemExit as ended:  # of the parser of options
        code = ended.code
    assert code == cli.USAGE_ERROR
    shown = capsys.readouterr()
    assert message in " ".join((shown.err + shown.out).replace("│", " ").split())
