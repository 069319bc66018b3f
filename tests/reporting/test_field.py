"""The table of the field: its numbers are those of the raw file, and holes stay holes."""

import csv
import gzip
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scripts import load_script
from synthetic_runs import adaptation_table, write_adaptation

from maesn.reporting import statistics
from maesn.reporting.sources import MANIFEST
from maesn.storage import write_json, write_rows
from maesn.studies.planned import PlannedLine
from maesn.studies.study import Study

COUNTS = (0, 1, 2, 3, 5, 10, 20)


@pytest.fixture
def field(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    module = load_script("results/field.py")
    here = tmp_path / "field"
    here.mkdir()
    for name in ("RESULTS", "LINES", "PUBLISHED"):
        monkeypatch.setattr(module, name, here / getattr(module, name).name)
    monkeypatch.setattr(module, "HERE", here)
    monkeypatch.setattr(module, "FIGURES", here)
    return module


def write(field: ModuleType, returns: np.ndarray) -> None:
    """Raw files of a search, random latents of the same policies and a memory of three episodes
    with three seeds, PEARL with two, and one line to do.

    All but the search have played 50 of the tasks alone, and return 0.7 less; random latents
    return 1.5 less after 100 episodes than the search after its last.
    """
    rows = [
        f"world,{line},{seed},{task},{COUNTS[k]},"
        f"{returns[seed, task, k] - behind},{float(task < 30)}"
        for line, seeds, tasks, behind in (
            ("maesn-search", 3, returns.shape[1], 0.0),
            ("maesn-random", 3, 50, 0.7),
            ("rl2", 3, 50, 0.7),
            ("pearl", 2, 50, 0.7),
        )
        for seed, task, k in np.ndindex(seeds, tasks, returns.shape[2])
    ]
    rows += [
        f"world,maesn-random,{seed},{task},100,{returns[seed, task, -1] - 1.5},0"
        for seed, task in np.ndindex(3, 50)
    ]
    text = "\n".join([",".join(field.RESULT), *rows, ""])
    field.RESULTS.write_bytes(gzip.compress(text.encode()))
    done = ",deploy,4000000,60,0.5,"
    lines = [f"maesn-search,maesn,MAESN,method,final,,,{seed}{done}" for seed in range(3)]
    lines += [f"maesn-random,maesn,random,method,final,,,{seed}{done}" for seed in range(3)]
    lines += [f"rl2,rl2,RL2,method,final,,3,{seed}{done}" for seed in range(3)]
    lines += [f"pearl,pearl,PEARL,method,final,,,{seed}{done}" for seed in range(2)]
    lines += [
        "rl2,rl2,RL2,method,final,,3,3,,,,,1.5",
        "varibad,varibad,VariBAD,method,final,,,0,,,,,2.25",
        "idle,idle,idle,baseline,final,,,0,deploy,,,,",
    ]
    lines = [f"world,{line}" for line in lines]
    field.LINES.write_text("\n".join([",".join(field.LINE), *lines, ""]))
    field.PUBLISHED.write_text(
        "family,name,episodes,return,spread,source\nworld,oracle,0,9.9,,by hand\n"
        "world,others,1,5,,\nworld,others,20,7.8, ±0.6,another budget\nelsewhere,x,0,1,,\n"
    )


def planned(folder: Path, seeds: list[int]) -> tuple[Path, PlannedLine]:
    """The file of a study of one run with these seeds, and its line."""
    file = folder / "small.toml"
    file.write_text(f'family = "point"\nseeds = {seeds}\n[runs.maesn]\n')
    (line,) = Study.load(file).comparisons[0].lines["lines"]
    return file, line


def rows_of(text: str) -> dict[str, dict[str, str]]:
    """The rows of a table by their first cells, each by the headings."""
    lines = (line for line in text.splitlines() if line.startswith("|"))
    head, _, *body = csv.reader(lines, delimiter="|")
    names = [name.strip() for name in head]
    return {row[1].strip(): dict(zip(names, map(str.strip, row), strict=True)) for row in body}


def test_the_table_says_what_the_raw_file_says(field: ModuleType) -> None:
    returns = np.random.default_rng(0).normal(size=(3, 60, 7)).round(3)
    write(field, returns)
    field.main()
    text = (field.HERE / "table.md").read_text()
    found = rows_of(text.partition("less that of others")[0])
    search, memory, few, undone, others = map(
        found.get, ("MAESN", "RL2, first 50 tasks", "PEARL", "VariBAD", "others")
    )
    for k, count in enumerate(COUNTS):
        shown, _, _ = search[str(count)].partition(" ")
        assert float(shown) == pytest.approx(returns[..., k].mean(), abs=0.05)
    worst = np.sort(returns[..., -1], axis=1)[:, :6].mean()
    interval = statistics.bootstrap(statistics.cvar, returns[..., -1])
    assert search["worst tenth"] == f"{worst:.1f} [{interval.low:.1f}, {interval.high:.1f}]"
    assert search["success (%)"] == "50.0"
    assert (search["seeds"], search["steps (M)"], search["minutes"]) == ("3", "4", "1.0")
    # Beyond the trials that it was trained for, a memory has no number.
    assert [memory[str(count)] != "-" for count in COUNTS] == [True] * 3 + [False] * 4
    assert memory["seeds"] == "3 of 4 (1.5 h to do)"
    # Two seeds are too few to be shown.
    assert few["seeds"] == "2"
    assert {few[str(count)] for count in COUNTS} == {"-"}
    assert undone["seeds"] == "0 of 1 (2.2 h to do)"
    assert (others["1"], others["20"]) == ("5", "7.8 ±0.6")
    assert "others: another budget" in text
    assert (field.HERE / "field.png").exists()
    ahead = rows_of(text.partition("less that of others")[2])
    assert list(ahead) == ["random", "RL2"]
    # Nothing but 0.7 differs in the same policies, so that nothing is left to chance.
    assert ahead["random"]["1"] == "0.7 [0.7, 0.7]"
    assert ahead["random"]["100"] == "1.5 [1.5, 1.5]"
    shown, _, interval = ahead["RL2"]["1"].partition(" ")
    low, high = map(float, interval.strip("[]").split(", "))
    assert shown == "0.7"
    assert low < 0.7 < high
    assert ahead["RL2"]["20"] == "-"


def test_the_figure_shows_families_in_which_a_search_has_results(field: ModuleType) -> None:
    write(field, np.random.default_rng(0).normal(size=(3, 60, 7)).round(3))
    kept = [row for row in field.read_rows(field.LINES) if row["line"] != field.SEARCH]
    write_rows(field.LINES, kept)
    field.main()
    assert not (field.HERE / "field.png").exists()


def test_what_is_done_stays_where_the_studies_directory_lacks_it(
    field: ModuleType, tmp_path: Path
) -> None:
    file, line = planned(tmp_path, [0, 1, 2])
    done, changed, begun = (
        (member.seed, jobs[-1].rpartition("-")[2]) for member, jobs in line.seeds
    )
    rows = [
        {"family": "point", "line": "maesn", "seed": seed, "job": job, "steps": 5}
        for seed, job in (done, (changed[0], "of-other-settings"))
    ]
    rows.append({"family": "point", "line": "maesn", "seed": begun[0], "job": begun[1]})
    rows[-1]["hours_left"] = "50"
    others = {"family": "of another study", "line": "maesn", "seed": "9", "hours_left": "2"}
    rows.insert(0, others)
    write_rows(field.LINES, [dict.fromkeys(field.LINE, "") | row for row in rows])
    results = [
        {"family": "point", "line": "maesn", "seed": seed, "task": 0, "episodes": 20}
        for seed in (done[0], changed[0])
    ]
    results.append(others | {"task": 0})
    results = [dict.fromkeys(field.RESULT, "1") | row for row in results]
    write_rows(field.RESULTS, [{name: row[name] for name in field.RESULT} for row in results])
    field.collect([str(file)], tmp_path / "elsewhere")
    first, *others_of_point = field.read_rows(field.LINES)
    assert {name: first[name] for name in others} == others
    found = {row["seed"]: row for row in others_of_point if row["line"] == "maesn"}
    assert (found["0"]["steps"], found["0"]["hours_left"]) == ("5", "")
    assert 0 < float(found["1"]["hours_left"]) < 50 == float(found["2"]["hours_left"])
    training = line.seeds[2][1][0]
    (tmp_path / "elsewhere" / "jobs" / training).mkdir(parents=True)
    field.collect([str(file)], tmp_path / "elsewhere")
    found = {row["seed"]: row for row in field.read_rows(field.LINES) if row["line"] == "maesn"}
    assert 0 < float(found["2"]["hours_left"]) < 50
    assert [row["seed"] for row in field.read_rows(field.RESULTS)] == ["0", "9"]


def test_a_seed_is_taken_if_the_study_has_it_from_the_same_jobs(
    field: ModuleType, tmp_path: Path
) -> None:
    file, line = planned(tmp_path, [0, 1])
    seeds = [{"seed": seed, "table": f"{seed}.csv", "training_steps": 7} for seed in (0, 1)]
    world = {"name": "point", "lines": [{"name": "maesn", "seeds": seeds}], "baselines": []}
    files = {"0.csv": line.seeds[0][1], "1.csv": ["of-other-settings"]}
    write_json(tmp_path / "small" / MANIFEST, {"comparisons": [world], "files": files})
    table = adaptation_table()
    for name in files:
        write_adaptation(tmp_path / "small" / name, table)
    field.collect([str(file)], tmp_path)
    done, stale, *_ = field.read_rows(field.LINES)
    assert (done["seed"], done["steps"], done["hours_left"]) == ("0", "7", "")
    assert (stale["seed"], stale["steps"]) == ("1", "")
    assert float(stale["hours_left"]) > 0
    results = field.read_rows(field.RESULTS)
    assert {row["seed"] for row in results} == {"0"}
    shown = np.isin(table.episodes, field.EPISODES)
    values = table.mean_return[:, shown].T.ravel()
    np.testing.assert_allclose([float(row["return"]) for row in results], values, atol=5e-4)
