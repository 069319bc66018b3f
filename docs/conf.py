"""Settings of Sphinx, which builds the documentation: `make docs`.

The source directory is that of the repository, so that pages can link to the results, and links
lead to the same places on the site and in the repository.
"""

import shutil
import sys
from pathlib import Path

from sphinx.application import Sphinx

from maesn import __version__

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "maesn"
author = "The maesn authors"
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "generated_reference",
]
root_doc = "docs/index"
include_patterns = ["docs/**.md", "results/**.md", "CHANGELOG.md", "CONTRIBUTING.md"]
exclude_patterns = [".venv*", "build", "runs", "src", "tests"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the types of arrays are long; shapes stand in the text
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
suppress_warnings = ["myst.header"]  # tables that a program has written begin at any level

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_extra_path = ["site/index.html"]  # the first page, which leads to `docs/index.html`
html_title = f"maesn {release}"
html_show_sourcelink = False
html_show_copyright = False


def setup(app: Sphinx) -> None:
    """Put the game where links in the repository lead to."""
    app.connect("build-finished", _copy_game)


def _copy_game(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        target = Path(app.outdir) / "docs" / "site"
        target.mkdir(parents=True, exist_ok=True)
        shutil.copy(Path(__file__).parent / "site" / "hide_a_goal.html", target)
