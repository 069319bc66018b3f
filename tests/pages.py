"""The pages of the documentation, and what stands in their blocks of code."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(
    page
    for pattern in ("*.md", "docs/**/*.md", "results/**/*.md", "examples/**/*.md")
    for page in ROOT.glob(pattern)
)
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)


def name_of(page: Path) -> str:
    """The path of a page below the repository's root."""
    return str(page.relative_to(ROOT))


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def blocks_of(page: Path, wanted: str) -> list[str]:
    """The blocks in one language."""
    return [code for language, code in FENCE.findall(page.read_text("utf-8")) if language == wanted]


def commands_of(page: Path) -> list[list[str]]:
    """The library's commands in the blocks of a page for a terminal, as lists of words."""
    return commands_in("\n".join(blocks_of(page, "console") + blocks_of(page, "bash")))


def commands_in(text: str) -> list[list[str]]:
    """The library's commands among lines of text."""
    lines = text.replace("\\\n", " ").splitlines()
    found = [re.match(r"\s*(?:\$ )?(?:\S*/)?maesn (.*)", line) for line in lines]
    return [shlex.split(one[1], comments=True) for one in found if one]
