"""Guides to a family or a rule of one's own, taken at their word: their files, their commands."""

import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest
from pages import ROOT, blocks_of, commands_of

from maesn import cli

# What makes each command take seconds.
FEW = ["--meta-batch-size", "2", "--episodes-per-task", "2", "--policy.hidden-sizes", "8"]
ADAPTED = ["--episodes", "4", "--episodes-per-update", "4"]
SMALL = {
    "train": [*FEW, "--iterations", "1"],
    "adapt": ADAPTED,
    "compare": [*ADAPTED, "--num-tasks", "2"],
    "render": ["--after", "0", "--shown", "1", "--episodes", "2", "--episodes-per-update", "2"],
}


@dataclass(frozen=True)
class Guide:
    """A page below `docs/howto/` that shows the file `module`.py."""

    page: str
    module: str

    @property
    def path(self) -> Path:
        """Where the page is."""
        return ROOT / "docs" / "howto" / self.page

    @property
    def verbs(self) -> set[str]:
        """What the commands do."""
        return {words[0] for words in commands_of(self.path)}

    def write(self, directory: Path) -> None:
        """Write the file: the listings that belong to it, in the order of the page."""
        shown = blocks_of(self.path, "python")
        files = [code for code in shown if code.startswith(f"# {self.module}.py")]
        (directory / f"{self.module}.py").write_text("\n".join(files), encoding="utf-8")

    def imported(self, directory: Path, patch: pytest.MonkeyPatch) -> ModuleType:
        """Write the file into a directory, which becomes the current one; import it for a test."""
        self.write(directory)
        patch.chdir(directory)
        patch.syspath_prepend(directory)
        module = importlib.import_module(self.module)
        del sys.modules[self.module]
        patch.setitem(sys.modules, self.module, module)
        return module

    def follow(self, *verbs: str, more: Sequence[str] = ()) -> None:
        """Run the commands that do one of these, in the current folder, with small numbers.

        Args:
            verbs: of the commands.
            more: further options.
        """
        for words in commands_of(self.path):
            if words[0] in verbs:
                assert cli.run([*words, *SMALL.get(words[0], []), *more]) == 0, words
