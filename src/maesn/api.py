"""The library's verbs. Their signatures and docstrings are the options and help of the commands.

In Python a run is given as a `Run`, its directory or its policy's name, and a family as itself or
as `module:name`.
"""

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import tyro
from tyro.conf import Positional

from maesn.context import Latent
from maesn.envs import RewardKind, TaskFamily
from maesn.evaluation import arguments, running
from maesn.evaluation.evaluation import USUAL
from maesn.evaluation.exploration import record_exploration, record_explorer
from maesn.learners import AbstractMetaLearner
from maesn.numerics.processes import ALONE, Sharing, is_lead, wait_for_all
from maesn.reporting.page import PAGE, PlotlyMissing, run_page, study_page, write_page
from maesn.reporting.reading import RECORD
from maesn.reporting.report import report_runs, report_study
from maesn.reporting.runs import EXPLORATION
from maesn.reporting.sources import studies_in
from maesn.reporting.tables import TextTable
from maesn.rules import AbstractRule, GradientRule, SearchRule
from maesn.runs.changes import change_run
from maesn.runs.config import RunSettings
from maesn.runs.export import exported_policy, write_policy
from maesn.runs.log import log_figures
from maesn.runs.run import Run
from maesn.runs.training import KEEP, train_live
from maesn.runtime.return_model import ReturnPrior
from maesn.runtime.search import SearchSettings
from maesn.search.prior import USUAL as USUAL_PRIOR
from maesn.search.prior import PriorSettings
from maesn.search.stored import find_prior, played_live, run_prior
from maesn.storage import RunError, check_writable, read_json
from maesn.worlds.budget import warn_of_duration


def train(
    learner: AbstractMetaLearner[Any, Any],
    settings: RunSettings,
    directory: str | Path,
    *,
    init_from: str | Path | None = None,
    family: TaskFamily | None = None,
    keep: int = KEEP,
    sharing: Sharing = ALONE,
) -> Run:
    """Meta-train in a new run directory, with a live display.

    Args:
        learner: the method and its settings; see `maesn.PRESETS`.
        settings: of the run.
        directory: must be empty or not exist.
        init_from: directory of a run, or name of a policy that comes with the library, whose policy
            and step sizes to start from.
        family: a family of your own; None for the one that `settings.family` names.
        keep: the latest checkpoints that stay, beside the first of each power of ten; 0 for all.
        sharing: several devices or processes that train this run together.

    Raises:
        RunError: a setting or the directory cannot be used.
        EpisodeError: an episode went wrong; the last good state is in the directory.
    """
    with sharing.begun():
        if is_lead():
            run = Run.create(directory, learner, settings, family=family, init_from=init_from)
        wait_for_all("the run is there")
        if not is_lead():
            run = Run.open(directory, settings.own_family if family is None else family)
        train_live(run, keep=keep)
    return run


def resume(
    run: Positional[arguments.AnyRun],
    iterations: int | None = None,
    family: arguments.AnyFamily = None,
    change: arguments.AnyChange = None,
    keep: int = KEEP,
    sharing: Annotated[Sharing, tyro.conf.arg(name="")] = ALONE,
) -> Run:
    """Go on with a run from its latest checkpoint, bit for bit as if it had never stopped.

    Args:
        run: Directory of the run.
        iterations: Total number of meta-iterations; None: what the run was started with.
        family: The run's family as `module:name`, if it is your own.
        change: Settings that are to differ from here on, as in `num_threads=2 reward=sparse
            trust_region.damping=0.1`; a mapping in Python. `config.json` keeps a record of it.
        keep: Latest checkpoints that stay, beside the first of each power of ten; 0: all of them.
        sharing: several devices or processes that go on with it together.

    Raises:
        RunError: there is no such run, or it cannot be changed so.
        EpisodeError: as for `train`.
    """
    with sharing.begun():
        run = Run.open(run, family=family)
        if change and is_lead():
            run = change_run(run, change)
        wait_for_all("the run is changed")
        if not is_lead():
            run = Run.open(run)
        train_live(run, iterations, keep)
    return run


def adapt(
    run: Positional[arguments.AnyRun],
    evaluation: arguments.AnyEvaluation = USUAL,
    *,
    out: arguments.OptionalPath = None,
    start: arguments.OptionalPath = None,
    family: arguments.AnyFamily = None,
    **settings: Any,
) -> running.Adapted:
    """Adapt the last checkpoint of a run to new tasks, and tabulate how it does.

    Args:
        run: Directory of the run, or the name of a policy that comes with the library, of which a
            copy is made, `maesn-NAME` in the current folder, unless a directory has its name.
        evaluation: tasks, reward, rule, budgets, seed.
        out: Table to write; None: `DIR/adaptation/TASKS-REWARD.csv`. Latents go beside it.
        start: Latents of an earlier adaptation to the same tasks (`.latents.npz`) to go on from.
        family: The run's family as `module:name`, if it is your own.
        settings: single settings of the evaluation by name, as in `episodes=100`.

    Raises:
        RunError: a setting cannot be used, or not together with another one.
        EpisodeError: an episode went wrong.
    """
    if out is not None and not Path(out).name:
        raise RunError(f"`out` must be the path of a table, got `{out}`: give it a name.")
    asked, opened = evaluation.changed(**settings), running.open_run(run, family)
    num_tasks = asked.count(opened.task_set(asked.tasks))
    warn_of_duration(opened.env(), num_tasks * asked.budget.episodes)
    check_writable(Path(out) if out else running.adaptation_file(opened.directory, asked))
    outcome, record = running.evaluate(opened, asked, None if start is None else Path(start))
    usual = running.adaptation_file(opened.directory, asked, outcome.first_update)
    return running.write_outcome(Path(out) if out else usual, outcome, record)


def prior(
    run: Positional[arguments.AnyRun],
    settings: Annotated[PriorSettings, tyro.conf.arg(name="")] = USUAL_PRIOR,
    *,
    reward: RewardKind = "sparse",
    sparse_radius: float | None = None,
    family: arguments.AnyFamily = None,
) -> Path:
    """Play an archive of latents in the training tasks: the prior of the rule `search`.

    It takes seconds to minutes, once after training; `adapt --rule search` does the same where it
    is missing. The file is `DIR/priors/REWARD-RADIUS.safetensors`; an earlier one is replaced.

    Args:
        run: Directory of the run, or the name of a policy that comes with the library, of which a
            copy is made, `maesn-NAME` in the current folder.
        settings: of the archive.
        reward: Reward of the new tasks.
        sparse_radius: Of the new tasks, in metres; None: the run's own.
        family: The run's family as `module:name`, if it is your own.

    Raises:
        RunError: the run has no latent, or a setting cannot be used.
        EpisodeError: an episode went wrong.
    """
    opened = running.open_run(run, family)
    with played_live() as progress:
        return run_prior(
            opened, settings, reward=reward, sparse_radius=sparse_radius, progress=progress
        )[0]


def export(
    run: Positional[arguments.AnyRun],
    path: Positional[arguments.AnyPath],
    family: arguments.AnyFamily = None,
    *,
    latents: arguments.OptionalPath = None,
    task: int | None = None,
    rule: arguments.AnyRule = None,
    overwrite: arguments.Flag = False,
) -> Path:
    """Write the last checkpoint of a run as one file for the NumPy runtime.

    A robot starts at the prior, or at a latent that an adaptation has found. From there its step
    sizes go on as those of `maesn adapt --start` would.

    Args:
        run: Directory of the run, or the name of a policy that comes with the library, unless a
            directory has its name.
        path: File to write, `.npz`.
        family: The run's family as `module:name`, if it is your own.
        latents: Latents that `maesn adapt` wrote for this run (`.latents.npz`), one of which the
            robot starts from.
        task: Index of its task, in the set that was adapted to.
        rule: How the robot adapts: gradient, or search with its settings behind it. Left out:
            gradient.
        overwrite: Replace a file that is there.

    Raises:
        RunError: the run cannot be exported, the file is there, or the latents are others or lack
            the task.
    """
    if not overwrite and Path(path).exists():
        raise RunError(
            f"`{path}` exists and would be replaced: give another path, or say so (--overwrite, in "
            "Python `overwrite=True`)."
        )
    opened = Run.open(run, family=family)
    method, checkpoint = opened.settings.method, opened.latest()
    learner = opened.learner.fast_learner(checkpoint.state)
    start = _adapted_start(opened, latents, task)
    search = _search(opened, rule, start)
    description: dict[str, Any] = {"method": method, "iteration": checkpoint.iteration}
    description |= {} if task is None else {"task": task}
    try:
        write_policy(path, exported_policy(learner, opened.env(), description, start, search))
    except (ValueError, OSError) as error:
        raise RunError(f"`{opened.directory}` cannot be exported to `{path}`: {error}") from error
    return Path(path)


class Reported(NamedTuple):
    """What `maesn.report` has written."""

    files: list[Path]
    """Figures, and tables of a study."""
    tables: list[TextTable]
    """Of a study: where each method ends, and who beats whom."""


def report(
    of: Positional[Sequence[arguments.AnyRun]],
    out: arguments.OptionalPath = None,
    family: arguments.AnyFamily = None,
) -> Reported:
    """Draw the figures of one or several runs, or figures and tables of a study.

    For runs, episodes of exploration are played first, and adaptation to the test tasks on sparse
    reward where no table of it is there yet. A table that is there is drawn as it is: after more
    training, `adapt` renews it. For a study, or a directory with several, nothing is played.

    Beside the figures goes `report.html`: one page that shows them, lets you move through the
    latents and watch a search. It needs no network; to write it needs the extra `maesn[page]`.

    Args:
        of: Directories of runs, or names of policies as for `maesn adapt`; several are compared in
            one figure. Or the directory of a study.
        out: Where the figures of runs go; None: `figures` in the first run's directory. Those of a
            study go into its directory. A name that ends in `.html` is that of the page, beside
            which the figures of runs go.
        family: The runs' family as `module:name`, if it is your own.

    Raises:
        RunError: no run is named, or one cannot be used.
    """
    if not of:
        raise RunError("name at least one run or study: maesn report DIR [DIR ...]")
    page = Path(out) if out is not None and Path(out).suffix == ".html" else None
    if not isinstance(of[0], Run) and (studies := studies_in(Path(of[0]))):
        if len(of) > 1 or (out is not None and (page is None or len(studies) > 1)):
            raise RunError(
                "a study is reported by itself, into its directory: maesn report DIR. The page of "
                "one study can go elsewhere: --out NAME.html"
            )
        files: list[Path] = []
        tables: list[TextTable] = []
        for path in studies:
            tables += report_study(path, files.append)
            files += _page(page or path / PAGE, study_page, path)
        return Reported(files, tables)
    opened = [running.open_run(run, family) for run in of]
    for run in opened:
        if not running.adaptation_file(run.directory, USUAL).exists():
            adapt(run)
        if run.env().planar:
            record_exploration(run, run.directory / EXPLORATION)
            record_explorer(run)
    directories = [run.directory for run in opened]
    folder = page.parent if page else Path(out or directories[0] / "figures")
    files = report_runs(directories, folder, print)
    if len(opened) == 1 and out is None:
        pictures = [file for file in files if file.suffix == ".png"]
        log_figures(directories[0], pictures, opened[0].latest().environment_steps)
    return Reported(files + _page(page or folder / PAGE, run_page, directories), [])


def _page(
    path: Path, document: Callable[[Any], Any], of: Any, say: Callable[[object], None] = print
) -> list[Path]:
    """Write the page of runs or a study; return its path, or say why there is none."""
    try:
        write_page(path, document(of))
    except PlotlyMissing as error:
        say(error)
        return []
    return [path]


def _adapted_start(
    run: Run, latents: str | Path | None, task: int | None
) -> tuple[Latent, int] | None:
    """Return the latent that an adaptation of the run has found, and the updates behind it."""
    if latents is None and task is None:
        return None
    if latents is None or task is None:
        raise RunError(
            "`latents` and `task` belong together: give the file that `maesn adapt` wrote, and the "
            "index of the task whose latent to start from."
        )
    record = Path(latents).with_suffix("").with_suffix(RECORD)
    weights = running.identity_of_run(run)["weights"]
    if record.exists() and read_json(record).get("weights") != weights:
        raise RunError(
            f"`{latents}` was adapted with other weights than the latest checkpoint of "
            f"`{run.directory}` has: adapt this run, and give the latents that this writes."
        )
    found, updates = running.read_latents(Path(latents))
    if not 0 <= task < len(found.mean):
        raise RunError(
            f"`task` must be an index from 0 to {len(found.mean) - 1}, the tasks of `{latents}`, "
            f"got {task}."
        )
    return Latent(found.mean[task], found.log_std[task]), updates


def _search(
    run: Run, rule: AbstractRule | None, start: tuple[Latent, int] | None
) -> tuple[ReturnPrior, SearchSettings] | None:
    """Return the prior and the settings of a rule, if it is a search."""
    if rule is None or isinstance(rule, GradientRule):
        return None
    if not isinstance(rule, SearchRule):
        raise RunError("`rule` must be `gradient` or `search`: the runtime has no other.")
    if start is not None:
        raise RunError("a search starts with no latent: leave out `latents` and `task`.")
    with closing(run.world(reward_kind="sparse")) as world:
        found = find_prior(run, run.latest_state(), world, rule.prior, rule.any_reward)
    return found, rule.settings
