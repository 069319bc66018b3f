"""What a study compares: lines in the same tasks, each with the jobs that evaluate its seeds."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from maesn.evaluation.evaluation import Evaluation
from maesn.reporting.style import METHOD_STYLES
from maesn.studies.members import AbstractMember


@dataclasses.dataclass(frozen=True)
class PlannedLine:
    """A run, a method from scratch or a baseline under one evaluation, with every seed."""

    name: str
    source: str  # name of the run or method, which lines under other evaluations share
    asked: Evaluation
    num_tasks: int
    trial_episodes: int | None
    trained_on: bool  # although it has another name, the set is that of training
    seeds: Sequence[tuple[AbstractMember, Sequence[str]]]
    """Members that differ in their seed alone, each with the jobs that evaluate it."""
    label: str = ""  # name in figures and tables

    @property
    def first(self) -> AbstractMember:
        """The member with the first seed."""
        return self.seeds[0][0]

    def document(self, seeds: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the line as the manifest has it, with these seeds."""
        asked, first = self.asked, self.first
        budget = {**asked.budget._asdict(), "num_tasks": self.num_tasks, "seed": asked.seed}
        known = {"trained_on": True} if self.trained_on else {}
        return {
            "name": self.name,
            "source": self.source,
            "method": first.method,
            "label": self.label,
            "addition": bool(asked.wrappers),
            "settings": first.settings,
            "evaluation": {**asked.protocol_record, "rule": asked.rule_text, **budget, **known},
            "trial_episodes": self.trial_episodes,
            "seeds": seeds,
        }


@dataclasses.dataclass(frozen=True)
class PlannedComparison:
    """Lines in the same tasks, under the same reward."""

    name: str
    world: Mapping[str, Any]
    """Family, variant, tasks, reward, radius and horizon, as the manifest has them."""
    lines: Mapping[str, Sequence[PlannedLine]]
    """The `lines` of the study; `baselines`, which learn nothing; the `oracle`, if there is one."""
    recorded: Mapping[str, str]  # name of a run -> the job that records its paths


def labelled(lines: Sequence[PlannedLine]) -> list[PlannedLine]:
    """Return lines as figures call them: by their methods, and what makes them differ."""
    labels = []
    for line in lines:
        method, usual = line.first.method, line.source.replace("_", " ")
        rivals = {one.source for one in lines if one.first.method == method}
        if method in METHOD_STYLES and len(rivals) == 1:
            usual = METHOD_STYLES[method].label
        added = f" ({line.asked.label})" if line.asked.label else ""
        labels.append((line.first.label or usual) + added)
    return [
        dataclasses.replace(
            line, label=label if labels.count(label) == 1 else f"{label} [{line.name}]"
        )
        for line, label in zip(lines, labels, strict=True)
    ]
