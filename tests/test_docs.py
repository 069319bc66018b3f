"""The documentation: every link leads somewhere, every example and every command runs."""

import ast
import dataclasses
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
from guides import Guide
from pages import PAGES, ROOT, blocks_of, commands_in, commands_of, name_of, prose

import maesn
from maesn import cli
from maesn.commands import options
from maesn.learners.gradient.info import GradientInfo, GroupShares
from maesn.learners.gradient.outer import FirstOrderInfo
from maesn.learners.pearl.meta_learner import PearlInfo
from maesn.learners.pearl.sac import SoftLosses
from maesn.learners.policy_steps import ProximalInfo
from maesn.learners.trial_meta import TrialInfo
from maesn.learners.varibad.inference import InferenceInfo
from maesn.learners.varibad.meta_learner import VaribadInfo
from maesn.numerics.trust_region import TrustRegionInfo

# Their programs take seconds, and what they call has tests of its own: `make test-docs` runs
# them.
LONG = [
    "README.md",
    "docs/tutorials/point.md",
    "docs/howto/evaluate.md",
    "docs/howto/latents.md",
    "docs/howto/own_environment_gymnasium.md",
    "docs/howto/own_environment_mujoco.md",
    "docs/howto/compare.md",
    "docs/explanation/methods/latent_search.md",
    "docs/explanation/methods/scratch.md",
]
UNDERSTOOD = 77
EXAMPLES = ROOT / "examples"  # as the pages say: export PYTHONPATH=examples
# Commands that read no options of tyro's.
NO_OPTIONS = (["--version"], ["list"], ["--help"])
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)|<(?:img|a)\s[^>]*(?:src|href)=\"([^\"]+)\"")


def anchors(page: Path) -> set[str]:
    """The fragments under which a page's headings can be reached."""
    headings = re.findall(r"^#+\s+(.+?)\s*$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def leads_somewhere(page: Path, link: str) -> bool:
    path, _, fragment = link.partition("#")
    target = (page.parent / path).resolve() if path else page
    return target.exists() and (
        not fragment or target.suffix != ".md" or fragment in anchors(target)
    )


def examples(page: Path) -> str:
    """The Python examples of one page, as one program: later ones may use the names of earlier."""
    return "\n".join(blocks_of(page, "python"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    links = [first or second for first, second in LINK.findall(prose(page))]
    local = [link for link in links if not re.match(r"[a-z]+:", link)]
    assert not [link for link in local if not leads_somewhere(page, link)]


def test_python_examples_import_what_there_is() -> None:
    """At once for all pages, also for those whose examples take long."""
    programs = [ast.parse(examples(page)) for page in PAGES]
    imports = [
        line
        for program in programs
        for line in program.body
        if isinstance(line, ast.Import)
        or (isinstance(line, ast.ImportFrom) and str(line.module).startswith("maesn"))
    ]
    assert imports
    for line in imports:
        exec(compile(ast.Module([line], []), "documentation", "exec"), {})


@pytest.mark.usefixtures("figures_unsaved")
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[pytest.mark.long] if name_of(page) in LONG else [])
        for page in PAGES
    ],
    ids=map(name_of, PAGES),
)
def test_python_examples_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(examples(page), page.name, "exec"), {"__name__": "__main__"})


def test_every_command_can_be_understood(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Guide("own_rule.md", "my_rules").write(tmp_path)  # named by options, which import it
    monkeypatch.syspath_prepend(tmp_path)
    # What follows the reading of options.
    monkeypatch.setattr(options, "enable_compilation_cache", lambda: sys.exit(UNDERSTOOD))
    # Results keep the commands of their time.
    pages = [page for page in PAGES if not page.is_relative_to(ROOT / "results")]
    commands = [(name_of(page), words) for page in pages for words in commands_of(page)]
    for example in EXAMPLES.glob("*.py"):
        usage = ast.get_docstring(ast.parse(example.read_text("utf-8"))) or ""
        indented = "\n".join(re.findall(r"^    .*", usage, re.MULTILINE))
        commands += [(example.name, words) for words in commands_in(indented)]
    assert {"train", "resume", "adapt", "report"} <= {words[0] for _, words in commands}
    for page, words in commands:
        here = [sys.executable if word.endswith("bin/python") else word for word in words]
        with pytest.raises(SystemExit) as end:
            sys.exit(cli.run(here))
        assert end.value.code == UNDERSTOOD or words in NO_OPTIONS, (page, words)


def test_every_study_can_be_understood(tmp_path: Path) -> None:
    blocks = [code for page in PAGES for code in blocks_of(page, "toml") if "family =" in code]
    assert blocks
    for code in blocks:
        (tmp_path / "mine.toml").write_text(code)
        assert maesn.Study.load(tmp_path / "mine.toml").jobs


def test_the_site_describes_every_method_and_every_public_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs" / "extensions")
    reference = importlib.import_module("generated_reference")
    assert all(f"## {method}" in reference.settings_of(method) for method in maesn.PRESETS)
    page = reference.python_api()
    assert not [name for name in maesn._MODULE_OF if f"maesn.{name}\n" not in page]


@pytest.mark.parametrize(
    ("prefix", "info"),
    [
        ("", GradientInfo),
        ("", TrialInfo),
        ("", VaribadInfo),
        ("inference/", InferenceInfo),
        ("shares/", GroupShares),
        ("outer/", TrustRegionInfo),
        ("outer/", FirstOrderInfo),
        ("policy_step/", ProximalInfo),
        ("", PearlInfo),
        ("losses/", SoftLosses),
    ],
)
def test_every_metric_is_described(prefix: str, info: type) -> None:
    page = (ROOT / "docs" / "reference" / "files.md").read_text("utf-8")
    rows = "".join(re.findall(r"^(\|[^|]*\|)", page, re.MULTILINE))
    told = (
        prose(ROOT / "docs" / "reference" / "files.md")
        .split("## metrics.jsonl")[1]
        .split("\n## ")[0]
    )
    for field in dataclasses.fields(info):
        name = f"{prefix}{field.name}"
        assert f"`{name}" in told or f"`.../{field.name}`" in rows, name


def test_make_check_runs_tests_that_exist() -> None:
    typed = subprocess.check_output(["make", "--dry-run", "fast"], cwd=ROOT, text=True)
    named = re.findall(r"tests/\S+\.py", typed)
    assert named
    assert [name for name in named if not (ROOT / name).exists()] == []
