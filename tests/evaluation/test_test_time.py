"""What is added to a learner in new tasks, from the command line to the table."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from small_runs import tiny_maesn, tiny_settings

from maesn import api, cli
from maesn.envs import point
from maesn.evaluation.record import written_out
from maesn.evaluation.test_time import AtTestTime, FineTuneRule
from maesn.learners import (
    METHODS,
    TRPO,
    BonusFastLearner,
    BonusMetaLearner,
    FineTuning,
    GradientFastLearner,
)
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.policies import GaussianMLP
from maesn.runs.run import Run
from maesn.runs.storage import RunError

pytestmark = pytest.mark.usefixtures("quick_compiler")


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("test_time") / "run"
    Run.create(directory, tiny_maesn(), tiny_settings())
    return directory


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("goals") / "few.npz"
    np.savez(path, goal=np.float32([[0.0, 2.0], [2.0, 0.0]]))
    return str(path)


def test_fine_tuning_has_a_table_of_its_own(trained: Path, few: str) -> None:
    options = ["--tasks", few, "--updates", "3", "--episodes-per-task", "3"]
    assert cli.run(["adapt", str(trained), *options]) == 0
    assert cli.run(["adapt", str(trained), *options, "--fine-tune", "trpo", "--after", "1"]) == 0
    tables = {path.name: path.read_text() for path in (trained / "adaptation").glob("*.csv")}
    assert set(tables) == {"file-few-sparse.csv", "file-few-sparse-1-then-trpo.csv"}
    plain, tuned = (tables[name].splitlines() for name in sorted(tables, reverse=True))
    # The same until the policy is tuned: after 0 and 1 updates.
    assert plain[:3] == tuned[:3]
    assert plain[4] != tuned[4]


def test_other_step_sizes_at_test_time(trained: Path, few: str) -> None:
    options = ["--tasks", few, "--updates", "3", "--episodes-per-task", "3"]
    paces = {
        "": [],
        "-steps-x2": ["--step-scale", "2"],
        "-3-full-steps": ["--full-steps", "3"],
    }
    latents = {}
    for suffix, asked in paces.items():
        assert cli.run(["adapt", str(trained), *options, *asked]) == 0
        table = trained / "adaptation" / f"file-few-sparse{suffix}.csv"
        assert table.exists()
        with np.load(table.with_suffix(".latents.npz")) as kept:
            latents[suffix] = kept["mean"]
    plain, doubled, paced = latents.values()  # [update, task, latent]
    # Up to the first update, in which the same episodes are learned from with steps of two sizes.
    np.testing.assert_allclose(doubled[1], 2 * plain[1], rtol=1e-5)
    # Steps 1, 1, 1/2 and steps 1, 1, 1: what differs is the third.
    np.testing.assert_array_equal(paced[:3], plain[:3])
    third, whole = (kept[3] - kept[2] for kept in (plain, paced))
    np.testing.assert_allclose(whole, 2 * third, rtol=1e-4, atol=1e-6)


def test_step_scales_that_differ_have_tables_that_differ() -> None:
    scales = (1.0, 2.0, 0.5, 0.12345678, 0.12345679)
    suffixes = [AtTestTime(step_scale=scale).suffix for scale in scales]
    assert suffixes[:3] == ["", "-steps-x2", "-steps-x0.5"]
    assert suffixes[3] != suffixes[4]


@pytest.mark.parametrize(
    ("name", "reason"), [("rl2", "no schedule of step sizes"), ("oracle", "it takes no steps")]
)
def test_a_method_without_steps_has_no_other_step_sizes(
    tmp_path: Path, few: str, name: str, reason: str
) -> None:
    run = Run.create(tmp_path / "run", METHODS[name](meta_batch_size=4), tiny_settings(method=name))
    with pytest.raises(RunError, match=f"`{name}` cannot be adapted like this: .*{reason}"):
        api.adapt(run.directory, tasks=few, test_time=AtTestTime(step_scale=2.0))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--step-scale -1", "`step_scale` must be positive and finite, got -1"),
        ("--step-scale inf", "`step_scale` must be positive and finite, got inf"),
        ("--full-steps 0", "`full_steps` must be at least 1, got 0"),
    ],
)
def test_step_sizes_that_mean_nothing_are_refused(
    trained: Path, capsys: pytest.CaptureFixture[str], option: str, message: str
) -> None:
    assert cli.run(["adapt", str(trained), *option.split()]) == cli.USAGE_ERROR
    assert message in capsys.readouterr().err


def test_the_record_of_curves_says_by_which_rule(trained: Path, few: str) -> None:
    tuning = AtTestTime(fine_tune="trpo", after=1, curious=True)
    api.adapt(trained, tasks=few, updates=2, episodes_per_task=3, test_time=tuning)
    record = trained / "adaptation" / f"file-few-sparse{tuning.suffix}.settings.json"
    learner = json.loads(record.read_text())["learner"]
    for settings in (TRPO, CuriosityBonus()):
        for name, value in vars(settings).items():
            assert f"{name}={written_out(value)}" in learner


def test_who_is_curious_and_fine_tuned_is_so_at_the_same_time(trained: Path) -> None:
    run, env = Run.open(trained), point.make_env()
    fast = run.learner.fast_learner(run.latest().state)
    both = AtTestTime(fine_tune="trpo", after=1, curious=True).add_to(fast, run, env, 3)
    assert isinstance(both, BonusFastLearner)
    assert isinstance(both.learner, FineTuning)
    assert isinstance(both.learner.learner, GradientFastLearner)


def test_other_curiosity_has_a_table_of_its_own(trained: Path, few: str) -> None:
    usual, other = (
        AtTestTime(curious=True),
        AtTestTime(curious=True, curiosity=CuriosityBonus(1e-3)),
    )
    assert usual.suffix == "-curious"
    assert other.suffix.startswith("-curious-")


def test_curiosity_in_adaptation_is_a_flag(trained: Path, few: str) -> None:
    extras = AtTestTime(curious=True)
    outcome = api.adapt(trained, tasks=few, updates=1, episodes_per_task=3, test_time=extras)
    assert outcome.curves.mean_return.shape == (2, 2)
    assert (trained / "adaptation" / "file-few-sparse-curious.csv").exists()


def test_a_curious_run_is_trained_stored_and_adapted(tmp_path: Path, few: str) -> None:
    command = (
        "train maesn+curiosity --family point --reward sparse --iterations 1 "
        "--episodes-per-task 3 --learner.meta-batch-size 2 --learner.policy.hidden-sizes 4 "
        f"--curiosity.updates 2 --curiosity.weight 0.5 --run {tmp_path / 'run'}"
    )
    assert cli.run(command.split()) == 0
    run = Run.open(tmp_path / "run")
    assert run.settings.method == "maesn+curiosity"
    assert isinstance(run.learner, BonusMetaLearner)
    assert run.learner.curiosity.weight == 0.5
    assert run.learner.learner.policy == GaussianMLP((4,))
    assert run.latest().iteration == 1
    assert "curiosity/bonus" in (run.directory / "metrics.jsonl").read_text()
    api.adapt(run.directory, tasks=few, updates=1, episodes_per_task=3)
    with pytest.raises(RunError, match=r"a run of maesn\+curiosity, which is curious already"):
        api.adapt(run.directory, tasks=few, test_time=AtTestTime(curious=True))


def test_what_cannot_be_given_is_refused_by_name(trained: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="`after` must be at least 0, got -2"):
        AtTestTime(fine_tune="trpo", after=-2)
    with pytest.raises(ValueError, match="`fine_tune_size` means nothing without `fine_tune`"):
        AtTestTime(fine_tune_size=0.1)
    with pytest.raises(ValueError, match="`fine_tune_size` must be positive and finite, got 0"):
        AtTestTime(fine_tune="trpo", fine_tune_size=0.0)
    settings = tiny_settings()
    recurrent = Run.create(tmp_path / "rl2", METHODS["rl2"](), settings)
    with pytest.raises(RunError, match=r"`rl2` cannot be adapted like this: .* without memory"):
        api.adapt(recurrent.directory, updates=11, test_time=AtTestTime(fine_tune="trpo"))
    with pytest.raises(RunError, match="`rl2` cannot be adapted like this: `learner` must learn"):
        api.adapt(recurrent.directory, test_time=AtTestTime(curious=True))
    with pytest.raises(RunError, match="`updates` must be more than `after`, got 10 and 10: no up"):
        api.adapt(trained, test_time=AtTestTime(fine_tune="trpo"))


def test_a_label_says_what_is_changed() -> None:
    assert AtTestTime().label == ""
    assert AtTestTime(step_scale=2.0, full_steps=10).label == "steps × 2; 10 full steps"
    tuned = AtTestTime(fine_tune="trpo", curious=True)
    assert tuned.label == "curious; 10 updates then TRPO"
    assert dataclasses.replace(tuned, fine_tune_size=0.05).label == f"{tuned.label} of 0.05"


@pytest.mark.parametrize(("name", "usual"), [("trpo", 0.01), ("reinforce", 0.1)])
def test_the_size_of_what_fine_tunes_reaches_its_rule(
    trained: Path, few: str, name: FineTuneRule, usual: float
) -> None:
    paths = {}
    for size in (None, usual, 3 * usual):
        tuning = AtTestTime(fine_tune=name, after=1, fine_tune_size=size)
        api.adapt(trained, tasks=few, updates=2, episodes_per_task=3, test_time=tuning)
        paths[size] = trained / "adaptation" / f"file-few-sparse{tuning.suffix}.csv"
    assert len(set(paths.values())) == 3
    assert paths[usual].read_text() == paths[None].read_text() != paths[3 * usual].read_text()
