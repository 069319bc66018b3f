"""The policies that come with the library: all that are there, by their names."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from scripts import load_script
from small_runs import Drift, create, finish

from maesn import api, cli
from maesn.evaluation.running import open_run
from maesn.reporting.reading import read_adaptation
from maesn.runs.run import Run
from maesn.runs.sources import TRAINED, find_run, policy_names, working_copy
from maesn.runtime import Explorer
from maesn.search.stored import prior_file

POLICIES = policy_names()
# A policy whose actions are choices has no export, and neither has that of PEARL.
EXPORTED = [
    name
    for name, run in zip(POLICIES, [Run.open(TRAINED / x) for x in POLICIES], strict=True)
    if run.env().action_kind == "continuous" and run.settings.method != "pearl"
]
LARGEST = 1_000_000  # bytes

ship = load_script("results/ship.py")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def files(directory: Path) -> dict[Path, bytes]:
    found = [path for path in directory.rglob("*") if path.is_file()]
    return {path.relative_to(directory): path.read_bytes() for path in found}


@pytest.mark.parametrize("name", POLICIES)
def test_each_is_a_finished_run_and_says_where_it_comes_from(name: str) -> None:
    run = Run.open(TRAINED / name)
    assert ship.name_of(run) == name
    assert run.latest().iteration == run.settings.iterations > 0
    assert run.settings.num_threads == 0  # all of those who adapt it
    assert len(run.checkpoints()) == 1
    provenance = json.loads((TRAINED / name / "config.json").read_text())["provenance"]
    assert provenance["command"].startswith(f"maesn train {run.settings.method}")
    assert re.fullmatch("[0-9a-f]{7,40}", provenance["commit"])
    assert sum(map(len, files(TRAINED / name).values())) < LARGEST


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        pytest.param(x, rule, marks=[pytest.mark.long] * ((x, rule) != ("wheeled", "search")))
        for x in POLICIES
        for rule in ("own", "search")
    ],
)
def test_each_adapts_to_tasks_that_it_has_not_seen(name: str, rule: str) -> None:
    installed, family = files(TRAINED), Run.open(TRAINED / name).family
    tasks = family.task_set("test", 12 if (name, rule) == ("wheeled", "search") else 40).tasks
    leaves = tasks if isinstance(tasks, tuple) else (tasks,)
    np.savez("some.npz", **dict(zip(family.task_names, leaves, strict=True)))
    options = ["--episodes", "60", "--episodes-per-update", "20"]
    if Run.open(TRAINED / name).settings.method == "pearl":
        options = ["--protocol", "pearl", "--episodes", "2"]
    if rule == "search":
        options = ["--rule", "search", "--episodes", "10"]
    words = ["adapt", name, "--tasks", "some.npz", "--out", "table.csv"]
    assert cli.run([*words, *options]) == 0
    returns = read_adaptation(Path("table.csv")).mean_return
    gain = returns[:, -1] - returns[:, 0]
    # Better by more than four standard errors of the mean over tasks.
    assert gain.mean() > 4 * gain.std(ddof=1) / np.sqrt(len(gain))
    assert files(TRAINED) == installed


@pytest.mark.parametrize("name", EXPORTED)
def test_each_can_be_exported_without_a_copy(name: str, folder: Path) -> None:
    assert cli.run(["export", name, "policy.npz"]) == 0
    assert [path.name for path in folder.iterdir()] == ["policy.npz"]
    assert Explorer.load("policy.npz", seed=0).update == 0


def test_a_prior_for_another_radius_goes_into_a_copy(folder: Path) -> None:
    run = Run.open("wheeled")
    places = {
        radius: prior_file(run, run.env("sparse", radius)).parents[1] for radius in (None, 1.5)
    }
    assert places == {None: TRAINED / "wheeled", 1.5: Path("maesn-wheeled")}


def test_the_copy_is_made_once_and_is_a_run_like_any_other() -> None:
    copy = working_copy("wheeled")
    assert copy == Path("maesn-wheeled")
    assert files(copy) == files(TRAINED / "wheeled")
    (copy / "notes.txt").touch()
    assert working_copy("wheeled") == copy
    assert (copy / "notes.txt").exists()
    assert working_copy(copy) == copy
    assert Run.open(copy).latest().iteration == Run.open(TRAINED / "wheeled").latest().iteration


def test_the_installed_directory_is_never_written_to() -> None:
    installed, opened = files(TRAINED / "wheeled"), Run.open("wheeled")
    copy = Path("maesn-wheeled")
    assert working_copy(TRAINED / "wheeled") == open_run(opened).directory == copy
    assert api.resume("wheeled").directory == copy
    assert files(TRAINED / "wheeled") == installed


def test_a_relative_path_of_the_installed_directory_is_not_written_to() -> None:
    assert working_copy(os.path.relpath(TRAINED / "wheeled")) == Path("maesn-wheeled")


def test_all_commands_use_the_copy_once_there_is_one() -> None:
    copy = working_copy("wheeled")
    assert find_run("wheeled") == Run.open("wheeled").directory == copy


def test_a_directory_of_that_name_wins() -> None:
    run = create(Path("wheeled"))
    assert find_run("wheeled") == working_copy("wheeled") == run.directory
    assert not Path("maesn-wheeled").exists()


def test_a_name_that_is_none_is_told_which_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["adapt", "weeled"]) == cli.USAGE_ERROR
    error = capsys.readouterr().err
    assert all(name in error for name in POLICIES)


def test_shipping_takes_the_last_checkpoint_and_leaves_a_run(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ship, "PRESETS", {"Drift": Drift})
    run = create(folder / "run")
    with pytest.raises(ValueError, match="0 of 6"):
        ship.ship(run, "0123abc", folder / "shipped")
    finish(run)
    ship.ship(run, "0123abc", folder / "shipped")
    ship.ship(run, "0123abc", folder / "shipped")  # replaces what is there
    shipped = Run.open(folder / "shipped")
    assert [path.name for path in shipped.checkpoints()] == ["iteration-000006.safetensors"]
    np.testing.assert_array_equal(shipped.latest_state().rows, run.latest_state().rows)


def test_shipping_leaves_out_the_replay(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ship, "PRESETS", {"Drift": Drift})
    monkeypatch.setattr(Drift, "replay", lambda _, state: state.rows)
    run = finish(create(folder / "run"))
    ship.ship(run, "0123abc", folder / "shipped")
    assert len(list(folder.glob("shipped/checkpoints/*"))) == 1
    shipped = Run.open(folder / "shipped").latest_state()
    np.testing.assert_array_equal(shipped.position, run.latest_state().position)
