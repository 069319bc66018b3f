"""The parts of the reference that are made from the library itself, while the site is built.

A page that contains a line `<!-- generated: NAME -->` gets what `GENERATORS[NAME]` returns there,
as Markdown, in place of the next line, which is for readers of the file.
"""

import contextlib
import io
import os
import re
import textwrap
from collections import defaultdict
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

import maesn
from maesn import cli
from maesn.envs import FAMILIES
from maesn.learners import PRESETS, recommended
from maesn.serialization import TAG, fields_to_json
from maesn.settings import leaves

if TYPE_CHECKING:
    from sphinx.application import Sphinx

WIDTH = 100  # characters of a help text
MARKER = re.compile(r"^<!-- generated: ([\w-]+) -->\n.+$", re.MULTILINE)

SINGLE_BACKTICKS = re.compile(r"(?<!`)`([^`]+)`(?!`)")
ATTRIBUTES: dict[str, list[str]] = {}

# What the public names of these packages are about, in the order of the page.
TOPICS = {
    "api": "Commands as functions",
    "runs": "Runs",
    "evaluation": "Adaptation to new tasks",
    "rules": "Rules and wrappers",
    "search": "Search",
    "learners": "Methods",
    "context": "Contexts",
    "inner": "Inner update",
    "policies": "Policies",
    "numerics": "Numerics",
    "envs": "Environments and families",
    "experience": "Episodes",
    "studies": "Studies",
    "worlds": "Worlds",
    "storage": "Errors",
}
# What holds no docstring of its own.
TABLES = {
    "FAMILIES": "The families of tasks, by name.",
    "PRESETS": "Functions that return a learner, by the name that `maesn train` takes.",
    "SCRATCH": "Functions that return a method from scratch, by name.",
    "Collect": "What plays episodes for a learner: agents and keys in, episodes out.",
}
# Packages with public names of their own.
PACKAGES = {"maesn.runtime": "For robots: `maesn.runtime`", "maesn.gym": "Gymnasium: `maesn.gym`"}


def command_line() -> str:
    """Return the help of all commands."""
    helps = {"": [], **{name: [name] for name in cli.COMMANDS}}
    helps |= {"train maesn": ["train", "maesn"], "train rl2": ["train", "rl2"]}
    return "\n".join(
        f"## maesn {name}\n\n```text\n{help_of(words)}\n```\n" for name, words in helps.items()
    )


def help_of(words: list[str]) -> str:
    """Return what `maesn WORDS --help` prints."""
    os.environ |= {"COLUMNS": str(WIDTH), "NO_COLOR": "1", "TERM": "dumb"}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        cli.run([*words, "--help"])
    if not printed.getvalue():
        raise RuntimeError(f"`maesn {' '.join(words)} --help` must print something.")
    lines = printed.getvalue().strip().splitlines()
    return "\n".join(textwrap.fill(line.rstrip(), WIDTH) for line in lines)


def python_api() -> str:
    """Return directives that document all public names by their docstrings."""
    by_topic: dict[str, list[str]] = defaultdict(list)
    for name, module in maesn._MODULE_OF.items():  # noqa: SLF001
        by_topic[module.split(".")[1]].append(name)
    parts = [section(title, "maesn", by_topic.pop(topic)) for topic, title in TOPICS.items()]
    if by_topic:
        raise RuntimeError(f"`TOPICS` must name the packages {sorted(by_topic)}.")
    for package, title in PACKAGES.items():
        public = vars(import_module(package)).items()
        names = [name for name, one in public if getattr(one, "__module__", "").startswith(package)]
        parts.append(section(title, package, names))
    return "\n".join(parts)


def section(title: str, module: str, names: list[str]) -> str:
    """Return a section that documents public names of a module."""
    directives = "\n".join(directive(module, name) for name in sorted(names, key=str.lower))
    return f"## {title}\n\n```{{eval-rst}}\n{directives}\n```\n"


def directive(module: str, name: str) -> str:
    """Return the directive that documents one name."""
    found = getattr(import_module(module), name)
    if name in TABLES:
        return f".. py:data:: {module}.{name}\n\n   {TABLES[name]}\n"
    if isinstance(found, type):
        return f".. autoclass:: {module}.{name}\n   :members:\n"
    return f".. autofunction:: {module}.{name}\n"


def method_settings() -> str:
    """Return a table for each method: its settings, and those that suit a family."""
    return "\n".join(settings_of(name) for name in PRESETS)


def settings_of(method: str) -> str:
    """Return the table of one method."""
    published = flat(PRESETS[method]())
    suited = {name: flat(recommended(method, name)) for name in FAMILIES}
    rows = [
        f"| `{name}` | {shown(value)} | {others(name, value, suited)} |"
        for name, value in published.items()
    ]
    head = [f"## {method}\n", "| setting | published | on a family |", "|---|---|---|"]
    return "\n".join([*head, *rows]) + "\n"


def others(name: str, value: object, suited: dict[str, dict[str, object]]) -> str:
    """Return the families on which a setting has another default, with it."""
    return ", ".join(
        f"{family}: {shown(found.get(name))}"
        for family, found in suited.items()
        if found.get(name) != value
    )


def flat(learner: object) -> dict[str, object]:
    """Return the settings of a learner by their path."""
    settings = leaves(fields_to_json(learner))
    return {name: value for name, value in settings.items() if name.split(".")[-1] != TAG}


def shown(value: object) -> str:
    """Return a setting as it is written on the command line."""
    text = " ".join(map(str, value)) if isinstance(value, list) else str(value)
    return f"`{text or '()'}`"


GENERATORS: dict[str, Callable[[], str]] = {
    "command-line": command_line,
    "python-api": python_api,
    "method-settings": method_settings,
}


def fill(app: "Sphinx", name: str, source: list[str]) -> None:
    """Replace the markers in a page; tables without a title get their path as one."""
    source[0] = MARKER.sub(lambda marker: GENERATORS[marker[1]](), source[0])
    if not source[0].startswith("# "):
        source[0] = f"# {name}\n\n{source[0]}"


def quote(app: "Sphinx", what: str, name: str, *rest: Any) -> None:
    """Turn the backticks of docstrings into those of reStructuredText."""
    lines = rest[-1]
    lines[:] = SINGLE_BACKTICKS.sub(r"``\1``", "\n".join(lines)).split("\n")
    if what == "attribute":
        ATTRIBUTES[name] = lines[:]


def keep_attribute(app: "Sphinx", what: str, name: str, *rest: Any) -> None:
    """Undo what Napoleon makes of an attribute's text, where it takes a colon to end a type."""
    if what == "attribute":
        rest[-1][:] = ATTRIBUTES[name]


def setup(app: "Sphinx") -> dict[str, bool]:
    """Connect this extension."""
    app.connect("source-read", fill)
    app.connect("autodoc-process-docstring", quote, priority=400)
    app.connect("autodoc-process-docstring", keep_attribute, priority=600)  # Napoleon has 500
    return {"parallel_read_safe": True}
