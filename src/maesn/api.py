"""The library's verbs. Their signatures and docstrings are the options and help of the commands.

In Python a run is given as a `Run`, its directory or its policy's name, and a family as itself or
as `module:name`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, Suppress, arg

from maesn.envs import RewardKind, TaskFamily, is_own
from maesn.envs.sources import resolve_family
from maesn.evaluation import arguments, running
from maesn.evaluation.evaluation import USUAL, AnyEvaluation
from maesn.evaluation.exploration import record_belief, record_exploration, record_explorer
from maesn.evaluation.exporting import Stated, export_run
from maesn.learners import AbstractMetaLearner, method_name
from maesn.numerics.devices import request_devices, sharing
from maesn.reporting.page import page_of, write_page
from maesn.reporting.reading import usual_table
from maesn.reporting.report import Reported, write_report
from maesn.reporting.runs import EXPLORATION
from maesn.reporting.sources import Compared, compare_runs, compare_study, studies_in
from maesn.runs.config import RunSettings, make_env
from maesn.runs.run import Run
from maesn.runs.training import KEEP, train_live
from maesn.search.prior import USUAL as USUAL_PRIOR
from maesn.search.prior import PriorSettings
from maesn.search.stored import played_live, run_prior
from maesn.settings import check_number, in_files
from maesn.storage import RunError, check_writable, refusals


def train(
    learner: Annotated[AbstractMetaLearner[Any, Any], arg(name="")],
    settings: Annotated[RunSettings, arg(name="")],
    directory: Annotated[arguments.OptionalPath, arg(name="run")] = None,
    *,
    init_from: arguments.OptionalPath = None,
    # On the command line `--family` is that of the settings.
    family: Annotated[TaskFamily | None, Suppress, arg(name="own-family")] = None,
    keep: int = KEEP,
    devices: int | None = None,
) -> Run:
    """Meta-train in a new run directory, with a live display.

    The command begins with the settings that were found to work on the family, where they are
    known; with `--settings reference`, with the published ones. A method of your own has its own.

    Args:
        learner: the method and its settings; see `maesn.PRESETS`.
        settings: of the run.
        directory: Directory of the new run; it must not hold a run yet. None:
            runs/METHOD-FAMILY-SEED.
        init_from: Run whose weights training starts from: its directory, or the name of a policy
            that comes with the library. What belongs to single tasks, such as latents, begins
            afresh.
        family: A family of your own; None for the one that `settings.family` names.
        keep: Number of latest checkpoints to keep, beside the first. 0: keep all.
        devices: Number of devices that share the tasks of a meta-batch. On a CPU, devices are
            threads. None: one; but for a method whose inner update moves the policy's weights, the
            largest number up to that of the cores which divides the tasks.

    Raises:
        RunError: a setting or the directory cannot be used.
        EpisodeError: an episode went wrong; the last good state is in the directory.
    """
    request_devices(devices)
    with refusals():
        check_number("keep", keep, 0)
    # Actions are choices in some families: nobody should have to say so.
    named = settings.family if family is None else family.name
    env = make_env(family or resolve_family(named), settings)
    learner = learner.for_actions(env.action_kind)
    if directory is None:
        names = (settings.own_method or method_name(learner), named)
        words = (in_files(name.rpartition(":")[2] if is_own(name) else name) for name in names)
        directory = Path("runs") / "-".join([*words, str(settings.seed)])
    with sharing(devices, learner.tasks_for_cores):
        run = Run.create(directory, learner, settings, family=family, init_from=init_from)
        train_live(run, keep=keep)
    return run


def resume(
    run: Positional[arguments.AnyRun],
    iterations: int | None = None,
    family: arguments.AnyFamily = None,
    method: arguments.AnyMethod = None,
    keep: int = KEEP,
    devices: int | None = None,
) -> Run:
    """Go on with a run from its latest checkpoint, bit for bit as if it had never stopped.

    This holds on the same number of devices: another number changes the last digits.

    Args:
        run: Directory of the run.
        iterations: Total number of meta-iterations; None: what the run was started with.
        family: The run's family as `module:name`, if it is your own.
        method: The run's method as `module:name`, if it is your own.
        keep: Number of latest checkpoints to keep, beside the first. 0: keep all.
        devices: Number of devices that share the tasks of a meta-batch, as for `maesn train`.

    Raises:
        RunError: there is no such run, or a setting cannot be used.
        EpisodeError: as for `train`.
    """
    request_devices(devices)
    run = running.open_run(run, family, method)
    with sharing(devices, run.learner.tasks_for_cores):
        train_live(run, iterations, keep)
    return run


def adapt(
    run: Positional[arguments.AnyRun],
    evaluation: AnyEvaluation = USUAL,
    *,
    out: arguments.OptionalPath = None,
    family: arguments.AnyFamily = None,
    method: arguments.AnyMethod = None,
    **settings: Any,
) -> running.Adapted:
    """Adapt the last checkpoint of a run to new tasks, and tabulate how it does.

    Of a policy that comes with the library, a copy is made, `maesn-NAME` in the current folder.

    Args:
        run: Directory of the run, or the name of a policy that comes with the library.
        evaluation: tasks, reward, rule, budgets, seed.
        out: Table to write; None: `DIR/adaptation/TASKS-REWARD.csv`. Latents go beside it.
        family: The run's family as `module:name`, if it is your own.
        method: The run's method as `module:name`, if it is your own.
        settings: single settings of the evaluation by name, as in `episodes=100`.

    Raises:
        RunError: a setting cannot be used, or not together with another one.
        EpisodeError: an episode went wrong.
    """
    asked, opened = evaluation.changed(**settings), running.open_run(run, family, method)
    asked.check_count(opened.task_set(asked.tasks))  # before the table gets its name
    table = Path(out) if out else running.adaptation_file(opened.directory, asked)
    check_writable(table)
    return running.write_outcome(table, *running.evaluate(opened, asked))


def prior(
    run: Positional[arguments.AnyRun],
    settings: Annotated[PriorSettings, arg(name="")] = USUAL_PRIOR,
    *,
    reward: RewardKind = "sparse",
    sparse_radius: float | None = None,
    family: arguments.AnyFamily = None,
    method: arguments.AnyMethod = None,
) -> Path:
    """Play an archive of latents in the training tasks: the prior of the rule `search`.

    It takes seconds to minutes, once after training; `adapt --rule search` does the same where it
    is missing. The file is `DIR/priors/REWARD-RADIUS.safetensors`; an earlier one is replaced.

    Args:
        run: Directory of the run, or the name of a policy, as for `maesn adapt`.
        settings: of the archive.
        reward: Reward of the new tasks.
        sparse_radius: Sparse radius of the new tasks, in metres; None: the run's own.
        family: The run's family as `module:name`, if it is your own.
        method: The run's method as `module:name`, if it is your own.

    Raises:
        RunError: the run has no latent, or a setting cannot be used.
        EpisodeError: an episode went wrong.
    """
    opened = running.open_run(run, family, method)
    with played_live() as progress:
        return run_prior(
            opened, settings, reward=reward, sparse_radius=sparse_radius, progress=progress
        )[0]


def export(
    run: Positional[arguments.AnyRun],
    path: Positional[arguments.AnyPath],
    family: arguments.AnyFamily = None,
    method: arguments.AnyMethod = None,
    *,
    latents: arguments.OptionalPath = None,
    task: int | None = None,
    rule: arguments.AnyRule = None,
    lower: arguments.AnyLimit = None,
    upper: arguments.AnyLimit = None,
    control_period: float | None = None,
    overwrite: arguments.Flag = False,
) -> Path:
    """Write the last checkpoint of a run as one file for the NumPy runtime.

    A robot starts at the prior, or at a latent that an adaptation has found, from which its step
    sizes go on. It is sent what the simulation lets through; the table that is shown says what
    that is.

    Args:
        run: Directory of the run, or the name of a policy that comes with the library.
        path: `.npz` file to write, for `maesn.runtime`.
        family: The run's family as `module:name`, if it is your own.
        method: The run's method as `module:name`, if it is your own.
        latents: Latents that `maesn adapt` wrote for this run (`.latents.npz`), one of which the
            robot starts from.
        task: Index of its task, in the set that was adapted to.
        rule: How the robot adapts: gradient, the default, or search with its settings behind it.
        lower: Smallest control, of all actuators or of each, where the simulation has a smaller one
            or none; -inf: none.
        upper: Largest control; inf: none.
        control_period: Seconds between two controls, where tasks differ in them.
        overwrite: Replace a file that is there.

    Raises:
        RunError: the run cannot be exported, the file is there, or the latents do not fit.
    """
    if not overwrite and Path(path).exists():
        raise RunError(
            f"`{path}` exists and would be replaced: give another path, or `--overwrite` "
            "(in Python, `overwrite=True`)."
        )
    opened, stated = Run.open(run, family, method), Stated(lower, upper, control_period)
    given = None if latents is None else Path(latents)
    export_run(opened, Path(path), rule, given, task, stated)
    return Path(path)


def report(
    of: Positional[Sequence[arguments.AnyRun]],
    out: arguments.OptionalPath = None,
    family: arguments.AnyFamily = None,
    method: arguments.AnyMethod = None,
) -> Reported:
    """Draw the figures of one or several runs, or figures and tables of a study.

    For runs, episodes of exploration are played first, and adaptation to the test tasks on sparse
    reward where no table of it is there yet. All tables that are there are drawn as they are: after
    more training, `adapt` renews them. For a study, or a directory with several, nothing is played.

    Beside the figures goes `report.html`, a page that lets you move through the latents, watch a
    search, or watch the belief of a method that holds one. It needs no network.

    Args:
        of: Directories of runs, or names of policies as for `maesn adapt`; several are compared in
            one figure. Or the directory of a study.
        out: Where the figures of runs go; None: `figures` in the first run's directory. Those of a
            study go into its directory.
        family: The runs' family as `module:name`, if it is your own.
        method: The runs' method as `module:name`, if it is your own.

    Raises:
        RunError: no run is named, or one cannot be used.
    """
    if isinstance(of, str | Path | Run):
        of = [of]
    if not of:
        raise RunError("name at least one run or study: maesn report DIR [DIR ...]")
    if out is not None and Path(out).suffix == ".html":
        raise RunError(f"`{out}` must be a directory: the page in it is `report.html`.")
    if not isinstance(of[0], Run) and (studies := studies_in(Path(of[0]))):
        if len(of) > 1 or out is not None:
            raise RunError("a study is reported by itself, into its directory: maesn report DIR.")
        all_of_them = Reported([], [])
        for path in studies:
            done = _report(compare_study(path), path)
            all_of_them.files.extend(done.files)
            all_of_them.tables.extend(done.tables)
        return all_of_them
    opened = [running.open_run(run, family, method) for run in of]
    for run in opened:
        if usual_table(run.directory) is None:
            adapt(run)
        if run.env().planar:
            record_exploration(run, run.directory / EXPLORATION)
            record_explorer(run)
            record_belief(run)
    directories = [run.directory for run in opened]
    return _report(compare_runs(directories), Path(out or directories[0] / "figures"))


def _report(study: Compared, out: Path) -> Reported:
    files, tables = write_report(study, out)
    return Reported([*files, write_page(out, page_of(study))], tables)
