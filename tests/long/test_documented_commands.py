"""The commands of the documentation from end to end, with small numbers.

Pages about families, rules and methods of one's own are run by tests of their own. A policy that
comes with the library is replaced by a tiny run in a directory of its name, which wins over it.
"""

import itertools
import re
from pathlib import Path

import pytest
from guides import ADAPTED, FEW, SMALL
from pages import ROOT, blocks_of, commands_of

from maesn import cli

_RL2 = [*FEW[:4], *(f"--{part}.descent.minibatches=1" for part in ("policy-step", "value"))]
_POINT = ["--family", "point", "--iterations", "1"]
_TASKS = ["--num-tasks", "2"]
FOLLOWED = [
    "tutorials/shipped_policy",
    "tutorials/point",
    "tutorials/study",
    *(f"howto/{name}" for name in ("train", "adapt", "own_goals", "films", "latents", "compare")),
    "howto/install",
]
# Minutes to days; `tests/studies` runs studies, and the tutorial's is run here.
TOO_LONG = ("study run quick", "study run paper", "study run ablation")


def small(words: list[str], iterations: int) -> list[str]:
    """The command with small numbers; of repeated options the last one counts."""
    if words[0] == "resume":
        return [*words, "--iterations", str(iterations)]
    if words[0] == "train" and "--tasks" in words:
        return [*words, *SMALL["train"], "--family", "point"]
    return [*words, *SMALL.get(words[0], []), *(_TASKS if words[0] == "adapt" else [])]


def make_runs(words: list[str]) -> None:
    """Train tiny runs where a command expects some."""
    for option, word in itertools.pairwise(words):
        named = re.fullmatch(r"wheeled|runs/([a-z0-9]+)[\w-]*", word)
        if named and option not in ("--run", "--family") and not Path(word).exists():
            method = named[1] if named[1] in ("rl2", "maml", "oracle") else "maesn"
            seed = "1" if word.endswith("-1") else "0"
            few = _RL2 if method == "rl2" else FEW
            assert cli.run(["train", method, *few, *_POINT, "--seed", seed, "--run", word]) == 0


@pytest.mark.usefixtures("figures_unsaved")
@pytest.mark.parametrize("name", FOLLOWED)
def test_commands_do_what_they_say(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = ROOT / "docs" / f"{name}.md"
    monkeypatch.chdir(tmp_path)
    for code in blocks_of(page, "toml")[:1]:
        tiny = re.sub(r"(iterations|num_tasks) = \d+", r"\1 = 2", code)
        tiny = re.sub(r"episodes = \d+", "episodes = 4", tiny)
        Path("steps.toml").write_text(
            re.sub(r"episodes_per_update = \d+", "episodes_per_update = 2", tiny)
        )
    for code in blocks_of(page, "python") if name == "howto/own_goals" else []:
        exec(code, {})
    commands = [words for words in commands_of(page) if not " ".join(words).startswith(TOO_LONG)]
    assert commands
    for count, words in enumerate(commands):
        make_runs(words)
        if words[0] == "report":  # it would play what is missing with the usual numbers
            assert cli.run(["adapt", words[1], *ADAPTED]) == 0
        assert cli.run(small(words, iterations=count + 2)) == 0, words
