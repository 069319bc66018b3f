"""Policies that come with the library, each a run directory of its last checkpoint alone."""

import shutil
from pathlib import Path

from maesn.storage import RunError, explained, new_directory

TRAINED = Path(__file__).resolve().parents[1] / "trained"


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

    This is the run's own. Of the policy `NAME` that comes with the library, whose directory is only
    read, it is a copy, `maesn-NAME` in the current folder, made when it is first asked for.
    """
    source = find_run(run)
    if source.parent != TRAINED:
        return source
    copy = Path(f"maesn-{source.name}")
    found = _content(copy)
    if found == _content(source):
        return copy
    if found:
        raise RunError(
            f"`{copy}` is another run than the policy `{source.name}` that comes with this version "
            f"of the library: name `{copy}` itself if it is meant, or move it away."
        )
    with new_directory(copy):
        shutil.copytree(source, copy, dirs_exist_ok=True)
    return copy


def _content(directory: Path) -> dict[str, bytes]:
    """Return what makes a run the one that it is, not what commands have left beside it."""
    files = [directory / "config.json", *sorted(directory.glob("checkpoints/*.safetensors"))]
    with explained("read", directory):
        return {file.name: file.read_bytes() for file in files if file.exists()}
