"""The ablation: what its lines differ in, and the chain from training to the figure."""

import csv
import shutil
from pathlib import Path

import pytest
from small_runs import create

from maesn import api, cli
from maesn.learners import AbstractMetaLearner, maesn, maesn_theta, maml, method_name, oracle
from maesn.policies import GaussianMLP
from maesn.report.style import series_styles
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.runs.serialization import digest, from_json, to_json
from maesn.studies.ablation import Ablation
from maesn.studies.ablation_lines import ABLATION, ablation_radii

pytestmark = pytest.mark.usefixtures("figures_unsaved")

OPTIONS = [
    *("ablation", "--family", "point", "--iterations", "2", "--meta-batch-size", "3"),
    *("--episodes-per-task", "3", "--episodes-per-update", "3", "--num-tasks", "3"),
    *("--episodes", "3", "--radii", "0.8", "1.0", "--only", "maml_bias_only", "maesn_fixed_steps"),
]

# One line that is not trained, at one radius.
NOTHING = ["--iterations", "0", "--only", "maml_bias_only", "--radii", "1"]


def seeds_in(table: Path) -> list[str]:
    """The seeds of the only line of a comparison, as often as they have a first task."""
    with table.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["method"] in ABLATION]
    return [row["seed"] for row in rows if row["task"] == row["update"] == "0"]


def line(name: str) -> AbstractMetaLearner:
    return ABLATION[name].make(300)


def test_all_lines_are_different_learners_that_can_be_stored() -> None:
    learners = {name: line(name) for name in ABLATION}
    assert len({digest(learner) for learner in learners.values()}) == len(ABLATION) == 10
    for learner in learners.values():
        assert from_json(to_json(learner)) == learner


def test_each_line_is_its_preset_with_one_thing_changed() -> None:
    assert line("maesn") == maesn()
    assert line("maml") == maml()
    methods = {name: method_name(line(name)) for name in ABLATION}
    assert methods["maml_bias"] == "maml_bias"
    assert methods["maml_learned_steps"] == "maml"
    assert methods["maesn_theta"] == "maesn_theta"
    assert line("maml_learned_steps").adaptation.policy.learned
    assert not line("maesn_fixed_steps").adaptation.context.learned
    assert line("maesn_fixed_steps").adaptation.context.initial_size == 1.0
    assert line("maesn_without_kl").context.kl_weight == 0.0
    assert [line(f"maesn_{count}_updates").inner_updates for count in (2, 3)] == [2, 3]


def test_theta_joins_in_the_second_half() -> None:
    for iterations in (300, 100):
        learner = ABLATION["maesn_theta"].make(iterations)
        assert learner.adaptation.policy.first_iteration == iterations // 2
    assert ABLATION["maesn_theta"].make(300) == maesn_theta()


def test_settings_reach_every_line() -> None:
    for variation in ABLATION.values():
        assert variation.make(10, meta_batch_size=5).meta_batch_size == 5


def test_the_published_radii_are_those_of_wheeled_alone() -> None:
    assert ablation_radii("wheeled") == (0.8, 1.0)
    # Blocks begin within 0.6 m of their goals: at radius 0.8 there would be nothing to learn.
    assert ablation_radii("blockpush") == ablation_radii("point") == (None,)
    assert Ablation(RunSettings(family="wheeled", sparse_radius=0.5)).radii == (0.5,)


def test_lines_can_be_told_apart() -> None:
    styles = series_styles(list(ABLATION))
    assert len({(style.colour, style.line, style.marker) for style in styles}) == len(ABLATION)


def test_families_without_a_published_figure_keep_their_own_radius(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begin = OPTIONS.index("--radii")
    usual = [*OPTIONS[:begin], *NOTHING[:-2], "--out", str(tmp_path)]
    assert cli.run(usual) == 0
    assert "Sparse reward, the family's own radius" in capsys.readouterr().out
    assert [path.name for path in tmp_path.glob("*radius*")] == ["own-radius"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--only", "maesm"], "`only` must name lines of the ablation, got maesm"),
        (["--iterations", "-1"], "`iterations` must be at least 0"),
        (["--episodes-per-task", "0"], "`episodes_per_task` must be at least 1"),
    ],
)
def test_wrong_options_get_a_sentence(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["ablation", "--out", str(tmp_path), *options]) == cli.USAGE_ERROR
    assert message in capsys.readouterr().err


def test_a_run_of_other_settings_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = [*OPTIONS, "--out", str(tmp_path), *NOTHING]
    assert cli.run(short) == 0
    capsys.readouterr()
    assert cli.run([*short, "--episodes-per-task", "4"]) == cli.USAGE_ERROR
    assert "was begun with `episodes_per_task` 3, but 4 is asked for" in capsys.readouterr().err
    assert cli.run([*short, "--meta-batch-size", "4"]) == cli.USAGE_ERROR
    assert "other settings of its learner" in capsys.readouterr().err


def test_seeds_that_would_join_must_have_been_trained_alike(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = [*OPTIONS, "--out", str(tmp_path), *NOTHING]
    assert cli.run([*short, "--training-seed", "1", "--meta-batch-size", "4"]) == 0
    capsys.readouterr()
    assert cli.run(short) == cli.USAGE_ERROR
    error = capsys.readouterr().err
    assert "maml_bias_only-seed-1` was begun with other settings of its learner" in error
    # It is said before anything is trained.
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["maml_bias_only-seed-1"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--radii 0.8 0", "`radii`: `sparse_radius` must be positive"),
        ("--tasks unheard-of", "unheard-of"),
        ("--oracle {oracle}", "must be a run on point to be compared there, got one on"),
    ],
)
def test_what_could_not_be_compared_is_refused_before_anything_is_trained(
    options: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = create(tmp_path / "oracle", oracle(policy=GaussianMLP((4,))), family="wheeled")
    command = [*OPTIONS, "--out", str(tmp_path), *options.format(oracle=other.directory).split()]
    assert cli.run(command) == cli.USAGE_ERROR
    assert message in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_copies_of_a_run_do_not_join_and_other_names_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = [*OPTIONS, "--out", str(tmp_path), *NOTHING]
    assert cli.run(short) == 0
    run = tmp_path / "runs" / "maml_bias_only-seed-0"
    for copy in (f"{run.name}-old", f"{run.name}-old-seed-0"):
        shutil.copytree(run, run.with_name(copy))
    assert cli.run(short) == 0
    assert seeds_in(tmp_path / "radius-1" / "table.csv") == ["0"]
    shutil.copytree(run, run.with_name("maml_bias_only-seed-1"))
    assert cli.run(short) == cli.USAGE_ERROR
    assert "must be called `maml_bias_only-seed-0`, because" in capsys.readouterr().err


@pytest.mark.long
def test_unfinished_runs_of_other_seeds_are_left_out_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [*OPTIONS, "--out", str(tmp_path), "--only", "maml_bias_only", "--radii", "1"]
    run = tmp_path / "runs" / "maml_bias_only-seed-1"
    assert cli.run([*command, "--training-seed", "1"]) == 0
    Run.open(run).checkpoints()[-1].unlink()
    capsys.readouterr()
    assert cli.run(command) == 0
    said = f"{run} is left out: it is at meta-iteration 0 of 2"
    assert said in capsys.readouterr().out.replace("\n", " ")
    assert seeds_in(tmp_path / "radius-1" / "table.csv") == ["0"]


def test_a_run_that_was_trained_for_longer_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = [*OPTIONS, "--out", str(tmp_path), *NOTHING]
    assert cli.run(short) == 0
    api.resume(tmp_path / "runs" / "maml_bias_only-seed-0", 1)
    capsys.readouterr()
    for seed in ("0", "1"):
        assert cli.run([*short, "--training-seed", seed]) == cli.USAGE_ERROR
        error = capsys.readouterr().err
        assert "seed-0` has gone on to meta-iteration 1, but the figure compares runs" in error
