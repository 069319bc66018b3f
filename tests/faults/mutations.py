"""Files that are damaged, cut, swapped, or written by somebody who means harm."""

import contextlib
import json
import logging
import os
import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from faults.forgeries import forged
from faults.material import MORE, Material
from faults.table import CLEAR, CONTINUED, EXECUTED, LOSS, Findings, is_of_tests
from small_runs import finish, tensors

from maesn import api
from maesn.reporting.reading import read_adaptation
from maesn.reporting.runs import read_learning_curve, read_run
from maesn.rules import SearchRule
from maesn.runs.run import Run
from maesn.runtime import Explorer
from maesn.storage import RunError

Read = Callable[[Path, Path], Any]
"""Reads a file, given the directory that is attacked and the file; returns what can be compared."""


def _run(directory: Path, _: Path) -> Any:
    run = Run.open(directory)
    finish(run, MORE)
    read_run(directory)
    return tensors(run.checkpoints()[-1])


def _log(directory: Path, file: Path) -> Any:
    with contextlib.suppress(RunError):  # plotting reads it as it is; training mends it first
        read_learning_curve(directory)
    return _run(directory, file)


def _table(_: Path, file: Path) -> Any:
    return vars(read_adaptation(file.with_suffix("").with_suffix(".csv")))


def _latents(directory: Path, file: Path) -> Any:
    path = directory / "policy.npz"
    api.export(Run.open(directory), path, latents=file, task=1)
    return Explorer.load(path).latent_mean


def _prior(directory: Path, file: Path) -> Any:
    path = directory / "policy.npz"
    api.export(Run.open(directory), path, rule=SearchRule(prior=str(file)))
    search = Explorer.load(path).exported.search
    assert search is not None
    return vars(search.prior)


def _policy(_: Path, file: Path) -> Any:
    explorer = Explorer.load(file, None if "saved" in file.name else 0)
    if not explorer.is_running:
        explorer.begin_episode()
    controls = [explorer.act([0.1, 0.2]) for _ in range(3)]
    assert np.isfinite(controls).all()
    return controls, explorer.latent_mean, explorer.update, len(explorer.episodes)


class Target(NamedTuple):
    """A file, and what reads it."""

    of: str
    """Which of the material it belongs to."""
    name: str
    read: Read
    compared: bool = True
    """Whether what is read must be what was written, or refused: the file has a checksum."""


ANOTHER = "another file"

TARGETS = (
    Target("run", "config.json", _run),
    Target("run", "checkpoints/iteration-000006.safetensors", _run),
    Target("run", "checkpoints/iteration-000004.safetensors", _run),
    Target("run", "metrics.jsonl", _log),
    Target("run", "timing.jsonl", _run),
    Target("run", "tasks.npz", _run),
    Target("latent", "adaptation/*.csv", _table, compared=False),
    Target("latent", "adaptation/*.settings.json", _table, compared=False),
    Target("latent", "adaptation/*.latents.npz", _latents),
    Target("latent", "priors/*.safetensors", _prior),
    Target("policies", "follows.npz", _policy),
    Target("policies", "searches.npz", _policy),
    Target("policies", "follows-saved.npz", _policy),
    Target("policies", "searches-saved.npz", _policy),
)


def attempt(stream: random.Random, material: Material, directory: Path, findings: Findings) -> None:
    """Change one file, and read it."""
    target = stream.choice(TARGETS)
    attacked, canary = directory / "attacked", directory / "executed"
    shutil.copytree(material.folders[target.of], attacked)
    (file,) = attacked.glob(target.name)
    is_forged = stream.random() < 0.5
    what = _forge(stream, file, canary) if is_forged else _damage(stream, file)
    what = f"{target.name}, {what}"
    before = _content(attacked)
    intact = _sound_lines(material.folders[target.of] / target.name, file)
    with _said() as sentences:
        try:
            found = target.read(attacked, file)
        except Exception as error:
            documented = (ValueError, OSError) if target.read is _policy else RunError
            if not (isinstance(error, documented) or is_of_tests(error)):
                raise
            after = _content(attacked)
            lost = [name for name, value in before.items() if not _kept(name, value, after)]
            findings.add(LOSS if lost else CLEAR, f"{what}: {lost} ({error})")
            return
        finally:
            if canary.exists():
                findings.add(EXECUTED, what)
    lost_lines = intact - set(file.read_bytes().splitlines()) if intact else set()
    fewer = file.suffix == ".jsonl" and file.read_bytes().count(b"\n") < MORE
    if lost_lines or (fewer and not sentences):
        findings.add(LOSS, f"{what}: lines {lost_lines}, {fewer}")
    elif is_forged or (what.endswith(ANOTHER) and target.of != "run"):
        findings.add(CONTINUED, what)  # who writes a sound file of another content is believed
    elif target.compared and not _same(found, _sound(target, material)):
        findings.add(LOSS, f"{what}: something else was read, without a word")
    else:
        findings.add(CONTINUED, what)


def _sound(target: Target, material: Material) -> Any:
    """What is read of the file as it was."""
    name = f"sound {target.name}".replace("/", " ").replace("*", "")
    if name not in material.read:
        directory = material.directory / name
        shutil.copytree(material.folders[target.of], directory)
        (file,) = directory.glob(target.name)
        material.read[name] = target.read(directory, file)
    return material.read[name]


def _damage(stream: random.Random, file: Path) -> str:
    """What a broken disk or a slip of the hand does."""
    content = bytearray(file.read_bytes())
    first, second = sorted(stream.randrange(len(content)) for _ in range(2))
    how = stream.choice(["bits", "bits", "cut", "empty", "zeros", "swap", "more", "gone", "odd"])
    if how == "bits":
        for _ in range(stream.choice([1, 1, 2, 8])):
            content[stream.randrange(len(content))] ^= 1 << stream.randrange(8)
    elif how == "cut":
        del content[first:]
    elif how == "empty":
        content.clear()
    elif how == "zeros":
        content[first:second] = bytes(second - first)
    elif how == "swap":
        content = content[second:] + content[first:second] + content[:first]
    elif how == "more":
        content += stream.randbytes(stream.randrange(1, 100))
    file.write_bytes(content)
    if how == "gone":
        file.unlink()
    elif how == "odd":
        how = _replace(stream, file)
    return f"{first} {second} {how}"


def _replace(stream: random.Random, file: Path) -> str:
    """Put what is no file in its place."""
    kept = file.rename(file.with_name(f".{file.name}"))
    things = ["a pipe", "a directory", "a link", "a link to itself", ANOTHER]
    how = stream.choice(things[1:] if file.suffix == ".jsonl" else things)  # logs are opened as is
    if how == "a directory":
        file.mkdir()
    elif how == "a pipe":
        os.mkfifo(file)
    elif how == ANOTHER:
        others = [path for path in file.parent.parent.rglob("*.*") if path.is_file()]
        shutil.copy(stream.choice(sorted(others)), file)
    else:
        file.symlink_to(kept if how == "a link" else file)
    return how


def _forge(stream: random.Random, file: Path, canary: Path) -> str:
    content = forged(stream, file, canary)
    file.write_bytes(content)
    return f"forged: {content[:3000]!r}"


def _content(directory: Path) -> dict[str, bytes]:
    """Everything that was finished."""
    files = (path for path in directory.rglob("*.*") if path.is_file() and not path.is_symlink())
    kept = (path for path in files if "tensorboard" not in path.parts and path.suffix != ".tmp")
    return {str(path): path.read_bytes() for path in kept}


def _kept(name: str, value: bytes, after: dict[str, bytes]) -> bool:
    """Whether a file is as it was; a log may have gone back to the checkpoint before."""
    found = after.get(name)
    if name.endswith(".jsonl") and found is not None:
        return found.splitlines()[:4] == value.splitlines()[:4]
    return found == value


def _sound_lines(original: Path, file: Path) -> set[bytes]:
    """The lines of a log that are as they were, and the only ones of their iteration."""
    if file.suffix != ".jsonl" or not file.is_file():
        return set()
    lines = [line for line in file.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]
    numbers = [_iteration(line) for line in lines]
    wanted = set(original.read_bytes().splitlines())
    found = zip(lines, numbers, strict=True)
    return {line[:-1] for line, number in found if numbers.count(number) == 1} & wanted


def _iteration(line: bytes) -> Any:
    try:
        return json.loads(line)["iteration"]
    except (ValueError, TypeError, LookupError, RecursionError):
        return None


def _same(found: Any, wanted: Any) -> bool:
    one, other = jax.tree.leaves(found), jax.tree.leaves(wanted)
    return len(one) == len(other) and all(map(np.array_equal, one, other))


@contextlib.contextmanager
def _said() -> Iterator[list[logging.LogRecord]]:
    """Yield the warnings that the library gives in the block."""
    records: list[logging.LogRecord] = []
    handler = logging.Handler()
    handler.emit = records.append  # type: ignore[method-assign]
    logger = logging.getLogger("maesn")
    logger.addHandler(handler)
    try:
        yield records
    finally:
        logger.removeHandler(handler)
