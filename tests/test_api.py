"""The verbs from end to end, as functions and as commands, on runs that take seconds."""

import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import maesn
from maesn import api, cli
from maesn import maesn as maesn_preset
from maesn.evaluation import exploration
from maesn.evaluation.running import adaptation_file
from maesn.policies import GaussianMLP
from maesn.reporting.reading import LATENTS
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.storage import RunError

SETTINGS = RunSettings(family="point", iterations=2, episodes_per_task=3)
# As in `small_runs`, so that they share compiled programs.
TINY = {"meta_batch_size": 4, "policy": GaussianMLP(hidden_sizes=(8,))}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("trained") / "run"
    maesn.train(maesn_preset(**TINY), SETTINGS, directory)
    return directory


def test_adapt_writes_the_table_and_the_latents(trained: Path) -> None:
    done = api.adapt(trained, episodes=6, episodes_per_update=3, tasks="validation")
    table = trained / "adaptation" / "validation-sparse-with-6-episodes-3-per-update.csv"
    assert (done.table, done.latents) == (table, table.with_suffix(LATENTS))
    lines = table.read_text().splitlines()
    assert lines[0] == (
        "task,update,episodes,purpose,mean_return,goal_return,success_rate,"
        "final_success_rate,time_in_region,solved_at_reset"
    )
    assert len(lines) == 1 + 100 * 3
    assert lines[3].startswith("0,2,6,explore,")
    with np.load(table.with_suffix(LATENTS)) as latents:
        np.testing.assert_array_equal(latents["mean"], done.outcome.contexts.mean)
        assert latents["mean"].shape == (100, 3, 2)


def test_tables_of_other_tasks_have_other_names(tmp_path: Path) -> None:
    names = []
    for folder, rows, write in (
        ("a", 3, np.savez),
        ("b", 4, np.savez),
        ("c", 3, np.savez_compressed),
    ):
        (tmp_path / folder).mkdir()
        path = tmp_path / folder / "test.npz"
        write(path, goal=np.ones((rows, 2), np.float32))
        names.append(adaptation_file(Path("run"), maesn.Evaluation(str(path))).name)
    assert re.fullmatch(r"file-test-[0-9a-f]{6}-sparse\.csv", names[0])
    assert names[0] == names[2] != names[1]
    with pytest.raises(RunError, match=r"absent\.npz"):
        adaptation_file(Path("run"), maesn.Evaluation(str(tmp_path / "absent.npz")))


@pytest.mark.usefixtures("figures_unsaved")
def test_plot_plays_what_is_missing_and_keeps_tables(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = api.adapt(trained, episodes=3, episodes_per_update=3).table
    tables = {short: short.read_bytes()}
    other = api.adapt(trained, episodes=3, episodes_per_update=3, seed=1).table
    tables[other] = other.read_bytes()
    assert short.read_bytes() == tables[short] != tables[other]  # none replaces another one
    monkeypatch.setattr(exploration, "EXPLORATION_EPISODES", 5)
    written = api.report([trained], tmp_path).files
    names = {path.name for path in written}
    assert {
        f"{name}-test-sparse.{kind}" for name in ("exploration", "tasks") for kind in ("png", "pdf")
    } <= names
    assert all(path.exists() for path in written)
    page = (tmp_path / "report.html").read_text()
    assert all(f"adaptation/{path.name}" in page for path in tables)  # it says what it has drawn
    Run.open(trained).checkpoints()[-1].touch()
    again = api.report([trained], tmp_path / "again").files
    assert {path: path.read_bytes() for path in short.parent.glob("test-*.csv")} == tables
    assert {path.parent for path in again} == {tmp_path / "again"}
    assert tmp_path / "again" / "report.html" in again


def test_export_and_refusal(trained: Path, tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    path.write_text("a policy of yesterday")
    command = ["export", str(trained), str(path)]
    with pytest.raises(RunError, match=r"policy\.npz` exists"):
        api.export(trained, path)
    assert cli.run(command) == cli.USAGE_ERROR
    assert path.read_text() == "a policy of yesterday"
    assert cli.run([*command, "--overwrite"]) == 0
    policy = path.read_bytes()
    assert api.export(trained, path, overwrite=True).read_bytes() == policy
    with pytest.raises(RunError, match="cannot be exported"):
        api.export(trained, tmp_path / "no" / "such" / "directory" / "policy.npz")


_OF_ANOTHER_TYPE = """
import maesn, os, sys
os.chdir(sys.argv[1])
for call in (
    lambda: maesn.adapt("wheeled", rule="search"),
    lambda: maesn.adapt("wheeled", wrappers="vime"),
    lambda: maesn.export("wheeled", "policy.npz", rule="search"),
    lambda: maesn.report("nowhere"),
    lambda: maesn.compare("nowhere"),
):
    try:
        call()
    except maesn.RunError as error:
        print(error)
"""


def test_what_is_no_rule_or_no_list_is_told_in_a_sentence(tmp_path: Path) -> None:
    """In a process of its own: here, annotations are enforced."""
    words = [sys.executable, "-c", _OF_ANOTHER_TYPE, str(tmp_path)]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    adapted, wrapped, exported, *others = said.splitlines()
    assert adapted == "`rule` must be a rule, such as `maesn.SearchRule()`, got 'search'."
    assert wrapped.startswith("`wrappers` must be a tuple of wrappers, such as")
    assert exported.endswith("`maesn.GradientRule()` or `maesn.SearchRule()`. It is 'search'.")
    assert [one.partition(":")[0] for one in others] == ["there is no run in `nowhere`"] * 2


def test_a_number_of_checkpoints_is_refused_before_the_run_is_made(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="`keep` must be at least 0, got -1"):
        api.train(maesn_preset(), RunSettings("point"), tmp_path / "run", keep=-1)
    assert not (tmp_path / "run").exists()


def test_help_answers_within_half_a_second() -> None:
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "maesn", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    seconds = time.perf_counter() - begin
    assert all(command in done.stdout for command in cli.COMMANDS)
    # What makes it fast is what it does not import; the time itself depends on the machine.
    assert not any(f" {heavy}\n" in done.stderr for heavy in ("jax", "numpy", "mujoco", "tyro"))
    assert seconds < 10


def test_version_and_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["--version"]) == 0
    assert capsys.readouterr().out == f"maesn {maesn.__version__}\n"
    assert cli.run(["list"]) == 0
    listed = capsys.readouterr().out
    assert "maml_bias_only" in listed
    assert "wheeled" in listed
