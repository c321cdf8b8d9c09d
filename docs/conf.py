"""The documentation site: ``make docs`` builds it with Sphinx into results/site.

The sources are the Markdown pages of the checkout, where they stand: a link that works in a checkout works on the site.
A page that is in no table of contents, a link without target and an anchor without heading are warnings; the build ends with an error.
"""

from __future__ import annotations

import importlib.metadata
import re

from docutils import nodes
from sphinx.application import Sphinx

project = "robomill"
author = "the developers of robomill"
version = release = importlib.metadata.version("robomill")
language = "en"

extensions = ["myst_nb", "sphinx_copybutton"]
root_doc = "docs/index"
include_patterns = [
    "docs/**",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "examples/*/README.md",
    "examples/kalman_sensor/kalman_sensor/*.md",
    "scenarios/recordings/README.md",
]
exclude_patterns = [".*", "blind", "results", "robomill", "tests"]

myst_heading_anchors = 4  # as the usual renderers of Markdown make them
highlight_language = "text"
nb_execution_mode = "off"  # they are executed by tests/test_notebooks.py

html_theme = "pydata_sphinx_theme"
html_title = "robomill"
html_theme_options = {
    "header_links_before_dropdown": 6,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "show_toc_level": 2,
}
html_copy_source = False
html_show_sourcelink = False
html_static_path = ["_static"]
html_css_files = ["narrow.css"]
html_context = {"default_mode": "auto"}  # light or dark, as the browser is set
html_extra_path = ["_root"]  # index.html: from the root of the site to the start page
html_use_index = False


LONG = 50
"""Characters from which a cell of a table needs width on a narrow screen (narrow.css): there they would fill six lines or more."""


def setup(app: Sphinx) -> None:
    """Prepare the cells of tables when a page has been read."""
    app.connect("doctree-read", lambda _, tree: [_prepare(cell) for cell in tree.findall(nodes.entry)])


def _prepare(cell: nodes.entry) -> None:
    """Mark a cell with a sentence; ranges and counts, such as 0.1 .. 0.3 and 3 of 4, stay in one line."""
    if len(cell.astext()) > LONG:
        cell["classes"].append("long")
    for text in list(cell.findall(nodes.Text)):
        if (kept := re.sub(r" \.\. |(?<=\d) of (?=\d)", lambda m: m[0].replace(" ", "\N{NO-BREAK SPACE}"), text)) != text:
            text.parent.replace(text, nodes.Text(kept))
