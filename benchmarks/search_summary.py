"""Means over tasks of the rows that `search_tables.py` has made, and tables of them."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from search_rows import read_row

from maesn.runs.run import Run
from maesn.search.prior import PriorSettings

HALF = 1.96  # standard errors in half a 95 % interval
AGAINST = ("search", 20)  # what all others are compared with, after so many episodes
TO_ADAPT = 20  # dense episodes of each training task behind the archive's adapted latents

Curve = dict[str, Any]


def summarize(out: Path) -> list[Curve]:
    """Return a row for each run, line and number of episodes: means over seeds and tasks."""
    rows: dict[tuple[str, str], list[dict[str, np.ndarray]]] = {}
    for path in sorted(out.glob("*-*-[0-9].csv")):
        run, line, _ = path.stem.rsplit("-", 2)
        rows.setdefault((run, line), []).append(read_row(path))
    found: list[Curve] = []
    for (run, line), seeds in rows.items():
        mean = {name: np.mean([seed[name] for seed in seeds], axis=0) for name in seeds[0]}
        base = rows.get((run, AGAINST[0]))
        for column, episodes in enumerate(mean["episodes"][0].astype(int)):
            here = {name: values[:, column] for name, values in mean.items()}
            found.append(
                {"run": run, "line": line, "seeds": len(seeds), "episodes": episodes}
                | _means(here)
                | _difference(here, line, base)
                | {"seed_means": " ".join(f"{s['deployed'][:, column].mean():.1f}" for s in seeds)}
            )
    return found


def _means(here: dict[str, np.ndarray]) -> Curve:
    nothing = np.full(len(here["deployed"]), np.nan)
    fresh = here.get("at_reset", np.zeros(len(nothing))) == 0  # tasks that are not solved at reset
    values = {name: here.get(name, nothing) for name in ("deployed", "drawn", "searching")}
    result: Curve = {"tasks": len(nothing)}
    for name, value in values.items():
        result |= {name: float(value.mean()), f"{name}_half": half(value)}
    result |= {
        "unsolved_tasks": int(fresh.sum()),
        "unsolved": float(here["deployed"][fresh].mean()),
    }
    result["unsolved_half"] = half(here["deployed"][fresh])
    for name in ("success", "drawn_success", "reached"):
        result[name] = float(here.get(name, nothing).mean())
    return result


def _difference(here: dict[str, np.ndarray], line: str, base: list[Any] | None) -> Curve:
    """Return search after 20 episodes less this, paired by task."""
    nothing = {"behind_search": np.nan, "behind_half": np.nan}
    if base is None or line.startswith("ood") or len(base[0]["task"]) < len(here["task"]):
        return nothing
    columns = np.flatnonzero(base[0]["episodes"][0] == AGAINST[1])
    if not len(columns):
        return nothing
    column = columns[0]
    best = np.mean([seed["deployed"][:, column] for seed in base], axis=0)
    gap = best[: len(here["deployed"])] - here["deployed"]
    return {"behind_search": float(gap.mean()), "behind_half": half(gap)}


def half(values: np.ndarray) -> float:
    """Return half the 95 % interval of a mean over tasks."""
    return float(HALF * values.std(ddof=1) / np.sqrt(len(values)))


def write_tables(curves: list[Curve], out: Path) -> str:
    """Return the tables as Markdown."""
    parts = []
    for run in dict.fromkeys(row["run"] for row in curves):
        own = [row for row in curves if row["run"] == run]
        parts += [f"## {run}", steps(out / "runs" / run)]
        for title, cell in _TABLES.items():
            parts += [f"{title}:", _table(own, cell)]
    return "\n\n".join(parts) + "\n"


def _number(name: str) -> Callable[[Curve], str]:
    def cell(row: Curve) -> str:
        width = row.get(f"{name}_half", np.nan)
        shown = f"{row[name]:.1f}" + (f" ± {width:.1f}" if np.isfinite(width) else "")
        return shown if np.isfinite(row[name]) else ""

    return cell


def _share(name: str) -> Callable[[Curve], str]:
    return lambda row: f"{row[name]:.1%}" if np.isfinite(row[name]) else ""


def _behind(row: Curve) -> str:
    if not np.isfinite(row["behind_search"]):
        return ""
    return f"{row['behind_search']:.1f} ± {row['behind_half']:.1f}"


_TABLES: dict[str, Callable[[Curve], str]] = {
    "Return of the deployed latent on 20 fresh episodes, ± half the 95 % interval over tasks": (
        _number("deployed")
    ),
    "Share of these episodes that reach the goal": _share("success"),
    "Return of the episodes played next, which are learned from (z drawn)": _number("drawn"),
    "Mean return while searching, over all episodes so far": _number("searching"),
    "Share of tasks whose goal was reached so far": _share("reached"),
    "Search after 20 episodes less this, paired by task": _behind,
    "Return without tasks that are solved at reset": _number("unsolved"),
}


def _table(rows: Iterable[Curve], cell: Callable[[Curve], str]) -> str:
    listed = list(rows)
    counts = sorted({row["episodes"] for row in listed})
    lines = ["| | tasks | seeds | " + " | ".join(map(str, counts)) + " |"]
    lines.append("|---" * (len(counts) + 3) + "|")
    for line in dict.fromkeys(row["line"] for row in listed):
        own = {row["episodes"]: row for row in listed if row["line"] == line}
        one = next(iter(own.values()))
        cells = [cell(own[count]) if count in own else "" for count in counts]
        if any(cells):
            lines.append(
                f"| {line} | {one['tasks']} | {one['seeds']} | " + " | ".join(cells) + " |"
            )
    return "\n".join(lines)


def steps(directory: Path) -> str:
    """Say how many environment steps training and prior took, and an episode takes."""
    run, usual = Run.open(directory), PriorSettings()
    env, tasks = run.env("sparse"), run.training_tasks
    played = usual.steps(env, tasks)
    dense = len(tasks) * TO_ADAPT * env.horizon
    return (
        f"Environment steps: {run.latest().environment_steps:,} of training, {played + dense:,} of "
        f"the prior, of which {dense:,} on dense reward, and {env.horizon} for each episode of a "
        "new task. The prior uses the sparse rewards of the training tasks at the radius of the "
        "test."
    )
