"""An explorer as a file: the exported policy, and beside it all that has changed since."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from maesn.runtime.archive import read_archive, write_archive
from maesn.runtime.exported import ExportedPolicy
from maesn.runtime.record import decoded, encoded
from maesn.runtime.safeguards import Safeguards
from maesn.runtime.search import LatentSearch, SearchHistory
from maesn.runtime.state import ExplorerState


@dataclass(frozen=True)
class Snapshot:
    """All of an explorer.

    Attributes:
        exported: what meta-training handed over.
        state: None in a file that was exported and not yet used.
        safeguards: limits on the executed controls and on the latent.
        random_state: state of NumPy's generator; None where `state` is None.
        history: what the search of the state has done, which files hold in its place.

    Raises:
        ValueError: the parts do not fit each other.
    """

    exported: ExportedPolicy
    state: ExplorerState | None = None
    safeguards: Safeguards = field(default_factory=Safeguards)
    random_state: Mapping[str, Any] | None = None
    history: SearchHistory | None = None

    def __post_init__(self) -> None:
        if self.state is not None:
            self.state.check_sizes(self.exported)
        if (self.random_state is None) != (self.state is None):
            raise ValueError("`state` and `random_state` belong together, but one is missing.")
        if self.random_state is not None:
            try:
                np.random.default_rng(0).bit_generator.state = self.random_state
            except (KeyError, OverflowError, TypeError, ValueError) as error:
                raise ValueError(f"`random_state` is damaged: {error}") from error


def write_snapshot(path: str | os.PathLike[str], snapshot: Snapshot) -> None:
    """Write an explorer, or an exported policy, to one file.

    Raises:
        OSError: the file cannot be written.
    """
    state = snapshot.state
    if state is not None and state.search is not None:
        search, state = state.search, replace(state, search=None)
        snapshot = replace(snapshot, state=state, history=search.history)
    write_archive(path, *encoded(snapshot))


def read_snapshot(path: str | os.PathLike[str]) -> Snapshot:
    """Return what a file holds.

    Raises:
        OSError: the file cannot be opened.
        ValueError: it is damaged, something else, or does not fit together.
    """
    snapshot = decoded(Snapshot, *read_archive(path))
    state, given = snapshot.state, snapshot.exported.search
    if state is None or given is None:
        return snapshot
    if snapshot.history is None:
        raise ValueError("entry `history` is missing, without which a search cannot go on.")
    search = LatentSearch.start(given.model, given.settings).repeated(snapshot.history)
    return replace(snapshot, state=replace(state, search=search))
