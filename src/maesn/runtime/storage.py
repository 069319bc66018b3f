"""An explorer as a file: the exported policy, and beside it all that has changed since."""

import os
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from maesn.runtime.archive import entry, read_archive, write_archive
from maesn.runtime.exported import ExportedPolicy
from maesn.runtime.safeguards import Safeguards
from maesn.runtime.state import ExplorerState

_EXPLORER = "explorer"


class Snapshot(NamedTuple):
    """All of an explorer."""

    exported: ExportedPolicy
    state: ExplorerState | None
    """None in a file that was exported and not yet used."""
    safeguards: Safeguards
    random_state: Mapping[str, Any] | None
    """State of NumPy's generator; None where `state` is None."""


def write_snapshot(path: str | os.PathLike[str], snapshot: Snapshot) -> None:
    """Write an explorer, or an exported policy, to one file.

    Raises:
        OSError: the file cannot be written.
    """
    exported, state = snapshot.exported, snapshot.state
    arrays, metadata = exported.arrays(), exported.metadata()
    if state is not None:
        arrays |= state.arrays(exported)
        metadata[_EXPLORER] = {
            **state.metadata(),
            "safeguards": snapshot.safeguards.metadata(),
            "random_state": snapshot.random_state,
        }
    write_archive(path, arrays, metadata)


def read_snapshot(path: str | os.PathLike[str]) -> Snapshot:
    """Return what a file holds.

    Raises:
        OSError: the file cannot be opened.
        ValueError: it is damaged, something else, or does not fit together.
    """
    arrays, metadata = read_archive(path)
    exported = ExportedPolicy.from_archive(arrays, metadata)
    if _EXPLORER not in metadata:
        return Snapshot(exported, None, Safeguards(), None)
    saved = entry(metadata, _EXPLORER, dict)
    return Snapshot(
        exported,
        ExplorerState.from_archive(arrays, saved, exported),
        _safeguards(entry(saved, "safeguards", dict)),
        _random_state(entry(saved, "random_state", dict)),
    )


def _safeguards(fields: dict[str, Any]) -> Safeguards:
    # Older files have this entry.
    if fields.pop("max_return_drop", None) is not None:
        raise ValueError("`max_return_drop` is no safeguard any more: load the policy anew.")
    try:
        return Safeguards(**fields)
    except TypeError as error:
        raise ValueError(f"entry `safeguards` is damaged: {error}") from error


def _random_state(state: dict[str, Any]) -> dict[str, Any]:
    try:
        np.random.default_rng(0).bit_generator.state = state
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"entry `random_state` is damaged: {error}") from error
    return state
