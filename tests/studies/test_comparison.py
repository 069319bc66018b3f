"""Comparisons from end to end, on runs that take seconds."""

import csv
import dataclasses
import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from small_runs import create, finish, tiny_maesn

from maesn import api, cli
from maesn.evaluation import evaluate
from maesn.evaluation.evaluation import Evaluation
from maesn.learners import ProximalStep, RecurrentValue, oracle, rl2
from maesn.numerics import MinibatchDescent
from maesn.policies import GaussianMLP, Recurrent
from maesn.policies.usual import USUAL
from maesn.report.reading import read_adaptation
from maesn.report.style import METHOD_STYLES
from maesn.rules import GradientRule
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.storage import RunError
from maesn.studies import curves, lines
from maesn.studies.comparison import Changes, compare, silent
from maesn.studies.lines import Scratch
from maesn.studies.world import WorldSettings, comparison_world

FEW = Evaluation(num_tasks=4, episodes=3, episodes_per_update=3, tasks_at_once=2)
SMALL = {"policy": GaussianMLP((8,)), "meta_batch_size": 4}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    place = tmp_path_factory.mktemp("runs")
    made = {
        "maesn": create(place / "maesn", tiny_maesn()),
        "again": create(place / "again", tiny_maesn(), seed=1),
        "oracle": finish(create(place / "oracle", oracle(**SMALL), iterations=2)),
    }
    return {name: run.directory for name, run in made.items()}


@pytest.fixture(autouse=True)
def small_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Methods from scratch with small networks, which compile and run faster."""
    monkeypatch.setitem(USUAL, "continuous", GaussianMLP((4,)))


@contextmanager
def adapted(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[list[int]]]:
    """Note the tasks of every adaptation that is played meanwhile."""
    played: list[list[int]] = []

    def noting(*arguments: object, tasks: list[int], **options: object) -> object:
        played.append(tasks)
        return evaluate.adapt(*arguments, tasks=tasks, **options)

    with monkeypatch.context() as patch:
        patch.setattr(curves, "adapt", noting)
        yield played


def table(out: Path) -> list[dict[str, str]]:
    with (out / "table.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.long
def test_methods_on_the_same_tasks(
    runs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = {
        "out": tmp_path,
        "scratch": Scratch(("reinforce", "trpo:2"), seeds=(0, 1)),
        "evaluation": FEW,
        "oracle": runs["oracle"],
    }
    with adapted(monkeypatch) as played:
        done = compare([runs["maesn"], runs["again"]], **asked)
    # Two seeds of each, by chunks of two tasks; two baselines, one oracle.
    assert sorted(map(tuple, played)) == sorted(
        (2 * 2 + 2 * 1 + 1) * [(0, 1), (2, 3)] + 2 * [(0, 1)]
    )
    assert [(line.name, line.seeds, line.num_tasks) for line in done.lines] == [
        ("maesn", (0, 1), 4),
        ("reinforce", (0, 1), 4),
        ("trpo", (0, 1), 2),
    ]
    means = {one.name: one.measure("mean_return")[..., 0].mean() for one in done.everyone}
    baseline = max(means["zero_action"], means["random_actions"])
    assert done.bounds(4) == pytest.approx((baseline, means["oracle"]))
    rows = table(tmp_path)
    counts = {name: sum(row["method"] == name for row in rows) for name in ("maesn", "trpo")}
    assert counts == {"maesn": 2 * 4 * 2, "trpo": 2 * 2 * 2}
    assert {row["steps"] for row in rows} == {"0", str(3 * 40)}
    for name in ("comparison.png", "comparison.pdf", "summary.md"):
        assert (tmp_path / name).stat().st_size > 500
    before = (tmp_path / "table.csv").read_bytes()
    with adapted(monkeypatch) as played:
        compare([runs["maesn"], runs["again"]], **asked)
    assert played == []
    assert (tmp_path / "table.csv").read_bytes() == before


def test_an_interrupted_comparison_goes_on_with_the_chunk_that_was_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object, tasks: list[int], **options: object) -> object:
        if tasks == [2, 3]:
            raise KeyboardInterrupt
        return evaluate.adapt(*arguments, tasks=tasks, **options)

    with closing(comparison_world(RunSettings(family="point"), FEW)) as world:
        (one,) = lines.line_of_scratch("reinforce", None, Scratch(), world).learners
        with monkeypatch.context() as patch:
            patch.setattr(curves, "adapt", interrupted)
            with pytest.raises(KeyboardInterrupt):
                curves.curves_of(one, world, tmp_path / "parts", silent)
        with adapted(monkeypatch) as played:
            parts = curves.curves_of(one, world, tmp_path / "parts", silent)
        assert played == [[2, 3]]
        whole = curves.curves_of(one, world, tmp_path / "whole", silent)
    assert parts.read_bytes() == whole.read_bytes()
    assert not list(tmp_path.glob("**/pieces"))


@pytest.mark.usefixtures("figures_unsaved")
def test_tables_of_adapt_are_used_where_they_fit(
    runs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = api.adapt(runs["maesn"], episodes=6, episodes_per_update=3)
    with adapted(monkeypatch) as played:
        done = compare([runs["maesn"]], out=tmp_path, evaluation=FEW)
    assert played == 2 * [[0, 1], [2, 3]]  # the baselines alone
    returns = done.lines[0].tables[0].mean_return
    # Tables have the digits of single precision.
    np.testing.assert_array_equal(np.float32(returns), outcome.curves.mean_return[:4, :2])
    style = METHOD_STYLES["maesn"]
    table = runs["maesn"] / "adaptation" / "test-sparse.csv"
    with closing(comparison_world(RunSettings(family="point"), FEW)) as world:
        (own,) = lines.line_of_runs("maesn", style, [Run.open(runs["maesn"])], world, FEW).learners
        assert own.earlier == table
        assert curves.curves_of(own, world, tmp_path, silent) == table
        for name in own.record:
            other = {"episodes": 9, "num_tasks": 101}.get(name, "something else")
            asked = dataclasses.replace(own, record={**own.record, name: other})
            assert not curves._fits(asked.record, asked.earlier)
        table.unlink()
        # Played anew, in chunks of another size: the same but for rounding.
        fresh = read_adaptation(curves.curves_of(own, world, tmp_path, silent))
    np.testing.assert_allclose(fresh.mean_return, returns, rtol=1e-4)


def test_what_decides_the_curves_of_a_method_from_scratch_is_written_out_in_full() -> None:
    with closing(comparison_world(RunSettings(family="point"), FEW)) as world:
        asked = [("trpo", 0), ("vime", 0), ("reinforce", 0), ("trpo", 1)]
        records = [
            lines.line_of_scratch(name, None, Scratch(seeds=(seed,)), world).learners[0].record
            for name, seed in asked
        ]
    assert "max_kl=0.01" in records[0]["learner"]
    assert "damping=0.1" in records[0]["learner"]
    assert "CuriosityBonus(" in records[1]["learner"]
    assert "GradientStep(step_size=0.1" in records[2]["learner"]
    assert "drifts=True" in records[0]["learner"]
    assert all("drifts=False" in record["learner"] for record in records[1:3])
    assert records[3] == records[0] | {"seed": 1}


def test_settings_of_methods_from_scratch_reach_them() -> None:
    scratch = Scratch(step_size=0.3, max_kl=0.07, curiosity_weight=0.01)
    with closing(comparison_world(RunSettings(family="point"), FEW)) as world:
        learners = {
            name: lines.line_of_scratch(name, None, scratch, world).learners[0].learner
            for name in ("reinforce", "trpo", "vime")
        }
    assert learners["reinforce"].improvement.rule.step_size == 0.3
    assert learners["trpo"].improvement.rule.trust_region.max_kl == 0.07
    assert learners["vime"].learner.improvement.rule.trust_region.max_kl == 0.07
    assert learners["vime"].curiosity.weight == 0.01


BUDGET = ["--num-tasks", "2", "--episodes", "9", "--episodes-per-update", "3"]


def methods_in(out: Path) -> list[str]:
    return list(dict.fromkeys(row["method"] for row in table(out)))


@pytest.mark.usefixtures("figures_unsaved")
def test_runs_take_part_a_second_time_with_what_is_added(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    added = [
        "--then",
        "trpo",
        "after=3",
        "--run-episodes",
        "3",
        "--scratch",
        "reinforce",
        "--twice",
        "maesn",
    ]
    command = ["compare", str(runs["maesn"]), *BUDGET, *added, "--twice", "maesn"]
    assert cli.run([*command, "--out", str(tmp_path)]) == 0
    plain, tuned, *_ = methods_in(tmp_path)
    assert plain == "maesn"
    assert tuned.startswith("maesn-3-episodes-then-trpo-")
    last = {row["method"]: int(row["update"]) for row in table(tmp_path)}
    # Runs whose steps stand still may end earlier.
    assert (last[plain], last[tuned], last["reinforce"]) == (1, 3, 3)
    cells = (tmp_path / "summary.md").read_text().replace(" ", "")
    # One seed, two tasks, one update, after meta-training; or three, after nothing.
    assert re.search(r"\|MAESN\|[0-9.e-]+M\|1\|2\|1\|", cells)
    assert "|REINFORCE||1|2|3|" in cells
    returns = {
        name: [row["mean_return"] for row in table(tmp_path) if row["method"] == name]
        for name in (plain, tuned)
    }
    # Until the weights join, after 0 and 3 episodes, the same.
    assert returns[plain] == [returns[tuned][k] for k in (0, 1, 4, 5)]


@pytest.mark.usefixtures("figures_unsaved")
def test_recurrent_policies_and_bonuses_go_through_the_same_evaluator(
    runs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An update of RL2 is an episode; it goes on beyond its trials, and is not fine-tuned."""
    learner = rl2(
        policy=Recurrent(hidden_size=3),
        policy_step=ProximalStep(descent=MinibatchDescent(epochs=1, minibatches=1)),
        value=RecurrentValue((), 3, (), MinibatchDescent(epochs=1, minibatches=1)),
        meta_batch_size=2,
    )
    recurrent = create(tmp_path / "rl2", learner).directory
    added = [
        "--then",
        "trpo",
        "after=3",
        "--bonus",
        "vime",
        "curiosity.weight=10",
        "curiosity.updates=20",
    ]
    command = ["compare", str(runs["maesn"]), str(recurrent), *BUDGET, *added]
    assert cli.run([*command, "--out", str(tmp_path / "out")]) == 0
    last = {(row["method"], row["task"]): row for row in table(tmp_path / "out")}
    steps = {who: int(row["steps"]) for who, row in last.items()}
    (second,) = {method for method, _ in last if method.startswith("maesn-")}
    assert steps["rl2", "0"] == steps["rl2", "1"] == 3 * 40
    assert steps[second, "1"] == 3 * 3 * 40
    assert not any(method.startswith("rl2-") for method, _ in last)
    # The bonus is learned from, but no part of the return.
    assert last[second, "0"]["mean_return"] != last["maesn", "0"]["mean_return"]
    shown = " ".join(capsys.readouterr().out.split())
    assert "RL² takes part as it is: `rl2` cannot be adapted like this" in shown
    assert "RL² was trained for trials of 2 episodes, and is beyond" in shown
    assert "MAESN (3 episodes, then TRPO; bonus by VIME)" in shown


@pytest.mark.usefixtures("figures_unsaved")
def test_a_method_follows_the_rule_that_is_chosen_for_it(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    """Its line replaces that of the run's own rule, and keeps its style."""
    few = Evaluation(num_tasks=2, episodes=9, episodes_per_update=3)
    rules = Changes(rules={"maesn": GradientRule(step_scale=2.0, full_steps=3)})
    plain = compare([runs["maesn"]], out=tmp_path / "plain", evaluation=few).lines[0]
    (done,) = compare([runs["maesn"]], out=tmp_path, evaluation=few, changes=rules).lines
    assert done.label == "MAESN (steps × 2; 3 full steps)"
    assert done.style.line == plain.style.line
    same = plain.measure("mean_return") == done.measure("mean_return")
    assert same[0, :, 0].all()
    assert not same[0, :, 1:].any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--out {0}", "`family` must be given"),
        ("--family point --out {0}", "name at least one run directory, or a method with --scratch"),
        ("--family point --scratch sac --out {0}", "no method `sac` that begins from scratch"),
        ("--family point --scratch trpo:x --out {0}", "must be a positive integer"),
        ("{1} --family wheeled --out {0}", "must be a run on wheeled"),
        ("{1} --episodes 75 --out {0}", "`episodes` must be a multiple of `episodes_per_update`"),
        ("{1} --run-episodes -50 --out {0}", "`episodes` must be at least 0, got -50"),
        (
            "{1} --then trpo after=50 --twice maml --out {0}",
            "`twice` must be methods of the runs, maesn; got maml",
        ),
        (
            "--family point --scratch trpo --then trpo after=50 --out {0}",
            "`then` and `bonus` add to trained runs, of which none take part",
        ),
        ("{1} --twice maesn --out {0}", "say what with `then` or `bonus`"),
        ("{1} --rule gradient --out {0}", "say of which method, as in `--rules maesn gradient`"),
        ("{1} --rules maml gradient --out {0}", "`rules` must be methods of the runs, maesn"),
        (
            "--family point --scratch trpo --max-kl 0 --out {0}",
            "`max_kl` must be positive and finite, got 0",
        ),
        ("{1} --curiosity-weight -1 --out {0}", "must be finite and at least 0, got -1"),
        ("{1} --step-size inf --out {0}", "`step_size` must be positive and finite, got inf"),
        ("{1} --oracle {0} --out {0}", "there is no run in"),
        ("{1} --oracle {1} --out {0}", "must be a run of `oracle`, which is given the task"),
        ("{2} --oracle {2} --out {0}", "an oracle is among the runs, and --oracle names one"),
        ("{1} --then trpo --out {0}", "must be more than `after`, got 500 and 500"),
        ("{1} --seed 4294967296 --out {0}", "`seed` must be at most 4294967295"),
        (
            "{1} --scratch-seeds 0 0 --out {0}",
            "`seeds` (--scratch-seeds) must be different numbers",
        ),
        ("{1} --scratch-seeds -1 --out {0}", "must be different numbers between 0 and 2^32 - 1"),
        ("{1} --scratch reinforce vpg --out {0}", "must name each method once, got reinforce vpg"),
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


def test_a_variant_in_which_a_run_sees_something_else_is_refused(tmp_path: Path) -> None:
    """On `blockpush` the paper's variant tells the goal, two components more."""
    run = create(tmp_path / "run", tiny_maesn(), family="blockpush")
    said = r"an environment of `observation_size` 28, as this .* `paper` has, got 26: compare it"
    with pytest.raises(RunError, match=said):
        compare([run.directory], out=tmp_path, world=WorldSettings(variant="paper"), evaluation=FEW)


def test_runs_in_different_worlds_are_refused(runs: dict[str, Path], tmp_path: Path) -> None:
    other = create(tmp_path / "other", tiny_maesn(), sparse_radius=1.0)
    with pytest.raises(RunError, match="must agree in `sparse_radius` to be compared"):
        compare([runs["maesn"], other.directory], out=tmp_path / "out", evaluation=FEW)
