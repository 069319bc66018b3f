"""Where runs are, and with what family and tasks they were made.

A policy that comes with the library is a run directory of its last checkpoint alone.
"""

from pathlib import Path

from maesn.envs import NAMED_SETS, TaskFamily, TaskSet, find_family
from maesn.envs.sources import find_tasks, load_tasks, resolve_family
from maesn.runs.config import CONFIG
from maesn.storage import RunError, explained, new_directory, write_whole

TASKS_FILE = "tasks.npz"  # in a run directory, if the tasks are a user's own
TRAINED = Path(__file__).resolve().parents[1] / "trained"


def recorded_family(recorded: str, given: str | TaskFamily | None) -> TaskFamily:
    """Return the family of a run: the library's of that name, or the user's that is given."""
    if given is None:
        try:
            return find_family(recorded)
        except ValueError as error:
            raise RunError(
                f"the run's family `{recorded}` does not come with the library: give it again, "
                "as `module:name` (--family on the command line)."
            ) from error
    family = resolve_family(given) if isinstance(given, str) else given
    if family.name != recorded:
        raise RunError(f"the run's family is `{recorded}`, but `{family.name}` was given.")
    return family


def recorded_tasks(directory: Path, name: str, digest: str, family: TaskFamily) -> TaskSet:
    """Return what a run was trained on; refuse tasks that have become others since."""
    file = directory / TASKS_FILE
    tasks = find_tasks(name, family) if name in NAMED_SETS else load_tasks(file, family)
    if tasks.digest() != digest:
        raise RunError(
            f"`{directory}` was trained on the task set {digest}, but its tasks `{name}` of family "
            f"`{family.name}` are now the task set {tasks.digest()}: restore what it was made with."
        )
    return tasks


def policy_names() -> list[str]:
    """Return the names of the policies that come with the library."""
    return sorted(path.name for path in TRAINED.iterdir() if path.is_dir())


def find_run(run: str | Path) -> Path:
    """Return the directory of a run, or of the policy of this name if there is no such path."""
    if Path(run).exists():
        return Path(run)
    if str(run) in policy_names():
        return TRAINED / run
    raise RunError(
        f"there is no run in `{run}`: name a directory that `maesn train` has made, or a policy "
        f"that comes with the library: {', '.join(policy_names())}."
    )


def working_copy(run: str | Path) -> Path:
    """Return the directory of a run that may be written to.

    Of the policy `NAME` that comes with the library it is a copy, `maesn-NAME` in the current
    folder, made when it is first asked for.
    """
    source = find_run(run)
    if source.parent != TRAINED:
        return source
    copy = Path(f"maesn-{source.name}")
    if not (copy / CONFIG).exists():
        files = [path.relative_to(source) for path in source.rglob("*.*")]
        files.sort(key=lambda file: file.name == CONFIG)  # last: it makes the copy whole
        with new_directory(copy, list(map(str, files))):
            for file in files:
                write_whole(copy / file, (source / file).read_bytes())
    elif _content(copy) != _content(source):
        raise RunError(
            f"`{copy}` is another run than the policy `{source.name}` that comes with this version "
            f"of the library: name `{copy}` itself if it is meant, or move it away."
        )
    return copy


def _content(directory: Path) -> dict[str, bytes]:
    """Return the files that make a run what it is."""
    with explained("read", directory):
        files = [directory / CONFIG, *directory.glob("checkpoints/*.safetensors")]
        return {file.name: file.read_bytes() for file in files}
