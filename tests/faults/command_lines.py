"""Command lines that are wrong: made from the options that the commands' own help lists."""

import contextlib
import io
import os
import random
import re
import shutil
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

from faults.material import Material
from faults.table import CLEAR, CONTINUED, LOSS, TRACEBACK, Findings, is_of_tests

from maesn import cli
from maesn.storage import RunError
from maesn.worlds.collector import Collector

ACCEPTED = "this line is right"

WORDS = (
    *("", "x" * 300, "x" * 5000, "x/" * 3000, "-1", "0", "1", "2.5", "1e400", "nan", "inf"),
    *("-inf", "9" * 22, "9" * 400, "-" + "9" * 30, "abc", "True", "None", "[" * 500, "{}", "()"),
    *("..", "/", "/dev/null", "/dev/zero", "/proc/self/mem", "~", "*", "point", "wheeled"),
    *("os:getcwd", ":x", "x:", "..:x", "a.b.c:d", "os:no", "ü", "\udcff", "%s%n", "--", "-", "="),
    *("a=b", "seed=x", "outer.curvature_stride=nan", "gradient", "gradient step_scale=x", "search"),
    *("gradient " + "(" * 500, "trpo after=-1", "vime x=1", "0x10", "1_000", "٣", "\n", "\t"),
)
"""What stands for a value."""


class Right(RunError):
    """All checks were passed: from here on it would be played."""


def attempt(stream: random.Random, material: Material, directory: Path, findings: Findings) -> None:
    """Make a right line wrong, in one way or two, and run it."""
    run = directory / "run"
    shutil.copytree(material.folders["latent"], run)
    before = {path: path.read_bytes() for path in run.rglob("*.*") if path.is_file()}
    line = list(stream.choice(_lines(run, directory)))
    things = [*WORDS, *_things(directory)]
    for _ in range(stream.choice([1, 1, 2])):
        line = _wrong(stream, line, things)
    code, said = _answer(line, directory)
    what = f"{[word[:200] for word in line]}: exit {code}, {said[-3000:]}"
    if ACCEPTED in said or code == 0:
        findings.add(CONTINUED, what)
    elif is_of_tests(said):
        findings.add(CLEAR, what)
    elif code != cli.USAGE_ERROR or "Traceback" in said or not said.strip():
        findings.add(TRACEBACK, what)
    else:
        same = all(path.is_file() and path.read_bytes() == x for path, x in before.items())
        findings.add(CLEAR if same else LOSS, what)


def _lines(run: Path, directory: Path) -> list[list[str]]:
    """A right line of each command."""
    there, new = str(run), str(directory / "new")
    return [
        ["train", "maesn", "--family", "point", "--run", new],
        ["train", "rl2", "--family", "point", "--run", new],
        ["resume", there],
        ["adapt", there],
        ["prior", there],
        ["compare", there, "--out", new],
        ["study", "run", "quick", "--out", new, "--dry-run"],
        ["study", "status", "quick", "--out", new],
        ["report", there, "--out", new],
        ["export", there, f"{new}.npz"],
        ["render", there, "--out", new],
        ["list"],
    ]


def _things(directory: Path) -> list[str]:
    """Paths of all that may stand where a file or a folder is wanted."""
    (directory / "pipe").exists() or os.mkfifo(directory / "pipe")
    (directory / "loop").symlink_to(directory / "loop")
    (directory / "dangling").symlink_to(directory / "nowhere")
    (directory / "file.npz").write_bytes(b"PK\x05\x06 no archive")
    (directory / "folder").mkdir()
    (directory / "link").symlink_to(directory / "folder")
    names = ("pipe", "loop", "dangling", "file.npz", "file.npz/x", "folder", "link", "run")
    return [str(directory / name) for name in names]


def _wrong(stream: random.Random, line: list[str], things: list[str]) -> list[str]:
    how = stream.choice(["option", "option", "option", "replaced", "gone", "misspelt", "more"])
    place = stream.randrange(len(line))
    if how == "option":
        value = [stream.choice(things)] if stream.random() < 0.95 else []
        return [*line, stream.choice(_options(line[0])), *value]
    if how == "replaced" and place:
        return [*line[:place], stream.choice(things), *line[place + 1 :]]
    if how == "gone":
        return [*line[:place], *line[place + 1 :]]
    if how == "misspelt":
        word = list(line[place])
        word.insert(stream.randrange(len(word) + 1), stream.choice("aZ-_.ü "))
        return [*line[:place], "".join(word), *line[place + 1 :]]
    return [*line[: place + 1], stream.choice(things), *line[place + 1 :]]


@cache
def _options(command: str) -> list[str]:
    """The options that a command's help lists."""
    words = ["maesn", "--family", "point"] if command == "train" else []
    _, said = _answer([command, *words, "--help"], Path.cwd())
    plain = re.sub(r"\x1b\[[0-9;]*m", "", said)
    return sorted(set(re.findall(r"(?<![\w-])--[a-z][a-z0-9._-]+", plain))) or ["--help"]


def _answer(line: list[str], directory: Path) -> tuple[Any, str]:
    """Run a line, up to where something would be played; return its exit status and its words."""

    def accept(*_: Any, **__: Any) -> Any:
        raise Right(ACCEPTED)

    text = io.StringIO()
    with (
        contextlib.chdir(directory),
        contextlib.redirect_stdout(text),
        contextlib.redirect_stderr(text),
        mock.patch.object(Collector, "__call__", accept),
        mock.patch.object(Collector, "play", accept),
    ):
        try:
            return cli.run(line), text.getvalue()
        except SystemExit as left:
            return left.code or 0, text.getvalue()
