"""What a study leaves for its report: one table per line and seed, and what is compared.

`DIR/NAME/study.json` names the tables in `DIR/NAME/tables`. `maesn.reporting.study` reads both, and
nothing else.
"""

import dataclasses
from pathlib import Path
from typing import Any

from maesn.reporting.reading import read_rows
from maesn.reporting.study import MANIFEST
from maesn.reporting.style import METHOD_STYLES
from maesn.runs.config import installed_versions
from maesn.storage import write_json, write_rows
from maesn.studies.jobs import DONE, ROWS, done_steps
from maesn.studies.plan import Plan, PlannedComparison, PlannedLine, PlannedSeed


def write_results(plan: Plan, jobs: Path, out: Path) -> list[str]:
    """Write what is done of a study; return the names of the jobs that are not.

    Args:
        plan: of the study.
        jobs: directory of the jobs.
        out: directory for manifest and tables.
    """
    comparisons = [
        _comparison(one, name, jobs, out)
        for one, name in zip(plan.comparisons, _names(plan), strict=True)
    ]
    document = {
        "study": plan.study.name,
        "comparisons": comparisons,
        "figures": [dataclasses.asdict(one) for one in plan.study.figures],
        "jobs": sorted(plan.jobs),
        "versions": installed_versions("mujoco.batch"),
    }
    write_json(out / MANIFEST, document)
    return [name for name in plan.jobs if not (jobs / name / DONE).exists()]


def _names(plan: Plan) -> list[str]:
    """Return a name for each comparison: its family, and what tells it from others there."""
    names = []
    for one in plan.comparisons:
        world, others = one.world, [two.world for two in plan.comparisons]
        others = [other for other in others if other.family == world.family]
        parts = [world.family.rpartition(":")[2]]
        if len({other.tasks for other in others}) > 1:
            parts.append(Path(world.tasks).stem)
        if len({other.reward for other in others}) > 1:
            parts.append(world.reward)
        if len({other.sparse_radius for other in others}) > 1:
            parts.append(f"radius-{world.sparse_radius:g}")
        names.append("-".join(parts))
    return names


def _comparison(one: PlannedComparison, name: str, jobs: Path, out: Path) -> dict[str, Any]:
    def lines(planned: tuple[PlannedLine, ...]) -> list[dict[str, Any]]:
        labels = _labels(planned)
        found = [
            _line(line, label, jobs, out / "tables" / name)
            for line, label in zip(planned, labels, strict=True)
        ]
        return [line for line in found if line["seeds"]]

    return {
        "name": name,
        **one.world._asdict(),
        "horizon": one.horizon,
        "lines": lines(one.lines),
        "baselines": lines(one.baselines),
        "oracle": lines((one.oracle,)) if one.oracle else [],
    }


def _labels(lines: tuple[PlannedLine, ...]) -> list[str]:
    """Return how figures call lines: each by its method, and what makes it differ from others."""
    own = [line.label or _usual_label(line, lines) for line in lines]
    full = [
        f"{label} ({line.evaluation.label})" if line.evaluation.label else label
        for label, line in zip(own, lines, strict=True)
    ]
    return [
        label if full.count(label) == 1 else f"{label} [{line.name}]"
        for label, line in zip(full, lines, strict=True)
    ]


def _usual_label(line: PlannedLine, lines: tuple[PlannedLine, ...]) -> str:
    """Return the method's name, or that of the run where several are of one method."""
    style = METHOD_STYLES.get(line.method)
    rivals = {one.source for one in lines if one.method == line.method}
    if style is None or len(rivals) > 1:
        return line.source.replace("_", " ")
    return style.label


def _line(line: PlannedLine, label: str, jobs: Path, tables: Path) -> dict[str, Any]:
    """Return what the manifest says of a line, with those seeds that are done."""
    done = [seed for seed in line.seeds if all((jobs / j / DONE).exists() for j in seed.jobs)]
    return {
        "name": line.name,
        "source": line.source,
        "method": line.method,
        "label": label,
        "addition": line.is_addition,
        "settings": dict(line.settings),
        "evaluation": {
            "rule": line.evaluation.rule_text,
            **line.evaluation.budget._asdict(),
            "num_tasks": line.num_tasks,
            "seed": line.evaluation.seed,
        },
        "trial_episodes": line.trial_episodes,
        "seeds": [_seed(seed, line.name, jobs, tables) for seed in done],
    }


def _seed(seed: PlannedSeed, name: str, jobs: Path, tables: Path) -> dict[str, Any]:
    """Put the rows of all tasks into one table."""
    table = tables / f"{name}-seed-{seed.seed}.csv"
    write_rows(table, [row for job in seed.jobs for row in read_rows(jobs / job / ROWS)])
    steps = done_steps(seed.training, jobs) if seed.training else seed.training_steps
    return {
        "seed": seed.seed,
        "table": str(table.relative_to(tables.parents[1])),
        "training_steps": steps,
    }
