"""The paper's last figure: what each part of MAESN contributes, from training to the table."""

import dataclasses
import re
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from maesn import api
from maesn.envs.sources import resolve_family
from maesn.evaluation.evaluation import Evaluation
from maesn.learners import AbstractMetaLearner
from maesn.report.comparison import Comparison
from maesn.report.style import series_styles
from maesn.runs.config import CONFIG, RunSettings, make_env
from maesn.runs.run import Run
from maesn.runs.serialization import digest
from maesn.storage import RunError, refusals
from maesn.studies.ablation_lines import ABLATION, ablation_radii
from maesn.studies.comparison import USUAL, compare_lines, silent
from maesn.studies.curves import Say
from maesn.studies.lines import line_of_runs
from maesn.studies.world import check_world, comparison_world, open_oracle

RUNS = "runs"


@dataclasses.dataclass(frozen=True)
class Ablation:
    """Which lines of the figure, and how they are trained."""

    settings: RunSettings
    """Of every run: family, seed, iterations, episodes per task."""
    only: tuple[str, ...] = ()
    """Names of some lines; empty for all."""
    learner: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Settings that all learners are given, such as `meta_batch_size`."""

    def __post_init__(self) -> None:
        unknown = [name for name in self.only if name not in ABLATION]
        if unknown:
            raise ValueError(
                f"`only` must name lines of the ablation, got {unknown[0]}: known are "
                f"{', '.join(ABLATION)}."
            )

    @property
    def radii(self) -> tuple[float | None, ...]:
        """Sparse radii of the new tasks: that of the settings, else those of the published figure.

        Where none was published, as on most families, None stands for the family's own.
        """
        own = self.settings.sparse_radius
        return ablation_radii(self.settings.family) if own is None else (own,)

    @property
    def names(self) -> list[str]:
        """Names of the lines, in the order of the figure."""
        return [name for name in ABLATION if not self.only or name in self.only]


def ablate(
    ablation: Ablation,
    out: str | Path,
    *,
    evaluation: Evaluation = USUAL,
    radii: Sequence[float] = (),
    oracle: str | Path | None = None,
    say: Say = silent,
) -> dict[float | None, Comparison]:
    """Meta-train the runs that are missing, adapt all at every radius, draw and tabulate.

    Runs that are finished are used, and unfinished ones are resumed, so that calling it again goes
    on where it stopped. Seeds that earlier calls have trained in the same directory join the
    figure.

    Args:
        ablation: which lines, trained how.
        out: directory of runs, curves, figures and tables.
        evaluation: of all lines.
        radii: sparse radii of the new tasks, in metres; none for `ablation.radii`.
        oracle: directory of a run of the preset `oracle`; without it there is no score.
        say: receives messages of progress.

    Returns:
        One comparison per radius; None stands for the family's own.

    Raises:
        RunError: a run in `out` is another one than is asked for; there are no such tasks, or no
            world with such a radius; the oracle is none, or one of another family.
    """
    out = Path(out)
    ceiling = None if oracle is None else open_oracle(oracle, ablation.settings.own_family)
    with refusals("`radii`: "):
        worlds = {
            radius: dataclasses.replace(ablation.settings, sparse_radius=radius)
            for radius in radii or ablation.radii
        }
    # Refused before hours of training: what could not be compared after them.
    for settings in worlds.values():
        with closing(comparison_world(settings, evaluation)) as world:
            check_world([ceiling] if ceiling else [], world)
    for name in ablation.names:
        for run in _runs(ablation, name, out / RUNS):
            _check_same(run, ablation, name)
    for number, name in enumerate(ablation.names, start=1):
        say(f"{number}. {ABLATION[name].label}: {ablation.settings.iterations} meta-iterations")
        _train(ablation, name, out / RUNS)
    runs = {name: _finished(ablation, name, out / RUNS, say) for name in ablation.names}
    done: dict[float | None, Comparison] = {}
    for radius, settings in worlds.items():
        say(f"adaptation on sparse reward, {radius_label(radius)}")
        with closing(comparison_world(settings, evaluation)) as world:
            lines = [
                line_of_runs(
                    name,
                    dataclasses.replace(style, label=ABLATION[name].label),
                    runs[name],
                    world,
                    evaluation,
                )
                for name, style in zip(runs, series_styles(list(runs)), strict=True)
            ]
            folder = out / ("own-radius" if radius is None else f"radius-{radius:g}")
            done[radius] = compare_lines(lines, world, folder, oracle=ceiling, say=say)
    return done


def radius_label(radius: float | None) -> str:
    """Return how a sparse radius is called in messages."""
    return "the family's own radius" if radius is None else f"radius {radius:g} m"


def _train(ablation: Ablation, name: str, directory: Path) -> None:
    """Begin or go on with the run of one line, unless it is finished."""
    settings = ablation.settings
    path = directory / _directory_name(name, settings.seed)
    if not (path / CONFIG).exists():
        api.train(_learner(ablation, name), settings, path)
    elif Run.open(path, settings.own_family).latest().iteration < settings.iterations:
        api.resume(path, settings.iterations, settings.own_family)


def _learner(ablation: Ablation, name: str) -> AbstractMetaLearner[Any, Any]:
    """Return what the run of one line trains."""
    settings = ablation.settings
    env = make_env(resolve_family(settings.family), settings)
    made = ABLATION[name].make(settings.iterations, **ablation.learner)
    return made.for_actions(env.action_kind)


def _runs(ablation: Ablation, name: str, directory: Path) -> list[Run]:
    """Return the runs of one line that there are, one per seed, in the order of the seeds.

    Directories of other names, such as copies of a run, have no part in it.
    """
    runs = [
        Run.open(config.parent, ablation.settings.own_family)
        for config in directory.glob(f"{name}-seed-*/{CONFIG}")
        if re.fullmatch(_directory_name(re.escape(name), r"\d+"), config.parent.name)
    ]
    return sorted(runs, key=lambda run: run.settings.seed)


def _directory_name(name: str, seed: int | str) -> str:
    return f"{name}-seed-{seed}"


def _check_same(run: Run, ablation: Ablation, name: str) -> None:
    """Refuse a run that is not what its line trains with the run's seed."""
    wanted = dataclasses.replace(ablation.settings, seed=run.settings.seed)
    remedy = "give the same again, move the run away, or give another --out."
    its_name = _directory_name(name, run.settings.seed)
    if run.directory.name != its_name:
        raise RunError(
            f"`{run.directory}` must be called `{its_name}`, because its seed is "
            f"{run.settings.seed}: give it its name back, or move it away."
        )
    free = ("method", "num_threads", "checkpoint_every")
    for field in dataclasses.fields(RunSettings):
        found, asked = (getattr(one, field.name) for one in (run.settings, wanted))
        if found != asked and field.name not in free:
            raise RunError(
                f"`{run.directory}` was begun with `{field.name}` {found}, but {asked} is asked "
                f"for: {remedy}"
            )
    if digest(run.learner) != digest(_learner(ablation, name)):
        raise RunError(
            f"`{run.directory}` was begun with other settings of its learner than are asked for: "
            f"{remedy}"
        )
    done = run.latest().iteration
    if done > wanted.iterations:
        raise RunError(
            f"`{run.directory}` has gone on to meta-iteration {done}, but the figure compares runs "
            f"after {wanted.iterations}: move it away, or give another --out."
        )


def _finished(ablation: Ablation, name: str, directory: Path, say: Say) -> list[Run]:
    """Return the runs of one line that are finished."""
    finished, wanted = [], ablation.settings.iterations
    for run in _runs(ablation, name, directory):
        done = run.latest().iteration
        if done < wanted:
            say(f"{run.directory} is left out: it is at meta-iteration {done} of {wanted}")
        else:
            finished.append(run)
    return finished
