"""Pages of the documentation taken at their word: the files that they show, their commands."""

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from scripts import ROOT

from maesn import cli

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
# What makes each command take seconds.
_FEW = ["--meta-batch-size", "2", "--episodes-per-task", "2", "--policy.hidden-sizes", "8"]
_SMALL = {
    "train": [*_FEW, "--iterations", "1", "--checkpoint-every", "1"],
    "adapt": ["--episodes", "4", "--episodes-per-update", "4"],
    "compare": ["--num-tasks", "2", "--episodes", "4", "--episodes-per-update", "4"],
    "report": [],
    "render": ["--after", "0", "--shown", "1", "--episodes", "2", "--episodes-per-update", "2"],
    "export": [],
}


@dataclass(frozen=True)
class Guide:
    """A page below `docs/howto/` whose file `module`.py is a family of one's own."""

    page: str
    module: str

    @property
    def files(self) -> list[str]:
        """Listings that belong to the file, in the order of the page."""
        shown = [code for language, code in self._blocks if language == "python"]
        return [code for code in shown if code.startswith(f"# {self.module}.py")]

    @property
    def commands(self) -> list[str]:
        """Commands of this library."""
        consoles = [code for language, code in self._blocks if language == "console"]
        lines = "".join(consoles).splitlines()
        return [line for line in lines if line.startswith("maesn ")]

    @property
    def verbs(self) -> set[str]:
        """What the commands do."""
        return {line.split()[1] for line in self.commands}

    def write(self, directory: Path) -> None:
        """Write the file."""
        (directory / f"{self.module}.py").write_text("\n".join(self.files), encoding="utf-8")

    def follow(self, *verbs: str, more: Sequence[str] = ()) -> None:
        """Run the commands that do one of these, in the current folder, with small numbers.

        Args:
            verbs: of the commands.
            more: further options.
        """
        for line in self.commands:
            words = shlex.split(line)[1:]
            if words[0] in verbs:
                assert cli.run([*words, *_SMALL[words[0]], *more]) == 0, line

    @property
    def _blocks(self) -> list[tuple[str, str]]:
        return _FENCE.findall((ROOT / "docs" / "howto" / self.page).read_text("utf-8"))
