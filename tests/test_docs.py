"""The documentation: every link leads somewhere, every Python example runs."""

import ast
import dataclasses
import re
from pathlib import Path

import pytest

from maesn.learners.gradient.info import GradientInfo, GroupShares
from maesn.learners.policy_steps import ProximalInfo
from maesn.learners.recurrent.meta_learner import RecurrentInfo
from maesn.learners.wrappers.meta_bonus import BonusInfo
from maesn.numerics.trust_region import TrustRegionInfo

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(
    page
    for pattern in ("*.md", "docs/**/*.md", "results/**/*.md", "examples/**/*.md")
    for page in ROOT.glob(pattern)
)
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
# Their programs take seconds, and what they call has tests of its own: `make docs` runs them.
LONG = [
    "docs/howto/own_environment_gymnasium.md",
    "docs/howto/own_environment_mujoco.md",
    "docs/howto/compare.md",
    "docs/explanation/methods/latent_search.md",
    "docs/explanation/methods/scratch.md",
]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)|<img[^>]*\ssrc=\"([^\"]+)\"")


def prose(page: Path) -> str:
    return FENCE.sub("", page.read_text(encoding="utf-8"))


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
    return "\n".join(
        code for language, code in FENCE.findall(page.read_text("utf-8")) if language == "python"
    )


def test_the_readme_is_among_the_pages() -> None:
    assert ROOT / "README.md" in PAGES


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    links = [first or second for first, second in LINK.findall(prose(page))]
    local = [link for link in links if not re.match(r"[a-z]+:", link)]
    assert not [link for link in local if not leads_somewhere(page, link)]


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


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


@pytest.mark.parametrize(
    ("prefix", "info"),
    [
        ("", GradientInfo),
        ("", RecurrentInfo),
        ("shares/", GroupShares),
        ("trust_region/", TrustRegionInfo),
        ("policy_step/", ProximalInfo),
        ("curiosity/", BonusInfo),
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
