"""Latent search beside what a user would take instead, with the same policies and latents.

    make peers                                               # in an environment with BoTorch
    .venv-peers/bin/python benchmarks/search_peers.py --out build/peers --results results/peers

Each search plays the archive of a shipped policy in new tasks, one latent in an episode, by
recorded episodes (`search_peers_play.py`), so all have the same latents and the same returns. The
deployed latent is judged by episodes that no search has seen. Beside the means are differences to
`maesn`'s search, paired by task, with half their 95 % interval, and seconds of one core for a
proposal. `archive's limit` is the best latent of each task; `limits_search.py` computes what no
search exceeds on the half circle. A finished row is a file in `--out`.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import botorch
import numpy as np
import torch
import tyro
from limits_search import limit_of, on_half_circle
from search_peers_methods import METHODS, SETTINGS, Known
from search_peers_play import JUDGED_AFTER, Recorded, prior_of, recorded, searched

from maesn.runs.run import Run

HALF_CIRCLE = ("wheeled", "ant")
OURS = next(iter(METHODS))
TIMED = 2  # tasks that the time of a proposal is measured in, one after the other
FIELDS = ("run", "method", "episodes", "mean", "half_interval", "behind", "behind_half", "seconds")


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    out: Path
    """Where recorded episodes and finished rows are kept."""
    results: Path | None = None
    """Where the table goes; None: it is printed alone."""
    runs: tuple[str, ...] = ("wheeled", "ant", "blockpush")
    """Policies that come with the library."""
    tasks: str = "test"
    """Task set."""
    num_tasks: int = 100
    """The first so many of them."""
    methods: tuple[str, ...] = tuple(METHODS)
    """Searches."""


def row(name: str, method: str, episodes: Recorded, known: Known, settings: Settings) -> dict:
    """Return what `searched` does, from a file if there is one."""
    slug = method.replace(" ", "-").replace(",", "")
    path = settings.out / f"row-{name}-{settings.tasks}-{settings.num_tasks}-{slug}.npz"
    if not path.exists():
        deployed, _ = searched(METHODS[method](known, len(episodes.far)), episodes)
        alone = [episodes[task : task + 1] for task in range(TIMED)]
        seconds = [searched(METHODS[method](known, 1), one)[1] for one in alone]
        partial = path.with_suffix(".partial.npz")
        np.savez(partial, deployed=deployed, seconds=np.mean(seconds))
        partial.replace(path)
    with np.load(path) as kept:
        return dict(kept)


def ceiling(episodes: Recorded) -> np.ndarray:
    """Return what each task's best latent returns: chosen by one half, judged by the other."""
    first = episodes.returns[:, :, : episodes.half].mean(axis=2)
    return np.take_along_axis(episodes.truth, first.argmax(axis=1)[:, None], 1)


def half_interval(values: np.ndarray) -> np.ndarray:
    """Return half the 95 % interval of the mean over tasks, `[count]`."""
    return np.asarray(1.96 * values.std(axis=0, ddof=1) / np.sqrt(len(values)))


def lines(name: str, settings: Settings) -> list[dict]:
    """Return the lines of the table of one policy."""
    if name in HALF_CIRCLE:
        whole, circle = on_half_circle(name, settings.tasks, settings.out)
    else:
        whole, circle = recorded(name, settings.tasks, settings.out), None
    episodes = whole[: settings.num_tasks]
    known, found = Known(SETTINGS.model(prior_of(Run.open(name)))), []
    ours = row(name, OURS, episodes, known, settings)["deployed"]
    for method in settings.methods:
        done = row(name, method, episodes, known, settings)
        found += summary(name, method, done["deployed"], ours, float(done["seconds"]))
        print(f"{name}, {method}: done", flush=True)
    best = np.repeat(ceiling(episodes), len(JUDGED_AFTER), axis=1)
    found += summary(name, "archive's limit", best, ours, np.nan)
    if circle is not None:
        limit = limit_of(circle)
        for label, means in (
            ("no search exceeds, 360 goals", limit.searcher),
            ("archive's limit, 360 goals", np.full(len(JUDGED_AFTER), limit.archive)),
        ):
            found += [
                {"run": name, "method": label, "episodes": n, "mean": mean}
                for n, mean in zip(JUDGED_AFTER, means, strict=True)
            ]
    return found


def summary(
    name: str, method: str, deployed: np.ndarray, ours: np.ndarray, seconds: float
) -> list[dict]:
    """Return the lines of one method, by number of episodes."""
    gain, error = (deployed - ours).mean(axis=0), half_interval(deployed - ours)
    spread, mean = half_interval(deployed), deployed.mean(axis=0)
    columns = zip(JUDGED_AFTER, mean, spread, gain, error, strict=True)
    return [dict(zip(FIELDS, (name, method, *one, seconds), strict=True)) for one in columns]


def printed(found: list[dict]) -> str:
    """Return the table for people."""
    text = ""
    for name in dict.fromkeys(line["run"] for line in found):
        counts = " | ".join(str(count) for count in JUDGED_AFTER)
        text += f"\n## {name}\n\n| method | {counts} | ms |\n"
        text += "|---" * (len(JUDGED_AFTER) + 2) + "|\n"
        for method in dict.fromkeys(line["method"] for line in found if line["run"] == name):
            own = [line for line in found if (line["run"], line["method"]) == (name, method)]
            cells = [cell(line) for line in own]
            seconds = own[0].get("seconds", np.nan)
            cells.append("" if np.isnan(seconds) else f"{1e3 * seconds:.1f}")
            text += f"| {method} | {' | '.join(cells)} |\n"
    return text


def cell(line: dict) -> str:
    """Return a mean, with its difference to our search if it is not that."""
    if "behind" not in line:
        return f"{line['mean']:.1f}"
    if line["method"] == OURS:
        return f"{line['mean']:.1f} ±{line['half_interval']:.1f}"
    return f"{line['mean']:.1f} ({line['behind']:+.1f} ±{line['behind_half']:.1f})"


def main(settings: Settings) -> None:
    """Print the table, and write it."""
    torch.set_num_threads(1)
    settings.out.mkdir(parents=True, exist_ok=True)
    found = [line for name in settings.runs for line in lines(name, settings)]
    print(printed(found))
    if settings.results is None:
        return
    settings.results.mkdir(parents=True, exist_ok=True)
    tasks = f"the first {settings.num_tasks} {settings.tasks} tasks"
    heading = HEADING.format(tasks=tasks, version=botorch.__version__)
    (settings.results / "summary.md").write_text(heading + printed(found))
    with (settings.results / "summary.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {key: f"{x:.5g}" if isinstance(x, float) else x for key, x in line.items()}
            for line in found
        )


HEADING = """# Latent search beside other searches

Mean return of the deployed latent after 1 to 20 episodes in {tasks}, with half its 95 %
interval; in brackets the difference to `search`, paired by task. All choose among the latents of
the shipped policy's archive and see the same recorded episodes. `ms`: milliseconds of one core for
a proposal. BoTorch {version}. `benchmarks/search_peers.py` wrote this file.
"""


if __name__ == "__main__":
    main(tyro.cli(Settings))
