"""All pages of docs/reference by name."""

from __future__ import annotations

import re
from pathlib import Path

from reference import formats
from reference.commands import cli_page
from reference.errors import errors_page
from reference.markdown import code, page, table
from reference.python_api import python_page

FOLDER = Path(__file__).parent.parent / "docs" / "reference"
CONTENTS = (
    """\
:hidden:

../nomenclature
cli
python
errors
""",
    """\
:hidden:
:glob:
:caption: File formats

formats/*
""",
)
"""Tables of contents of the site; Sphinx does not show them on the page."""


def _first_sentence(text: str) -> str:
    """First sentence below the heading of a page, links as text."""
    lead = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text.split("\n\n")[2].replace("\n", " "))
    return re.split(r"(?<=\.) (?=[A-Z`])", lead)[0]


def pages() -> dict[str, str]:
    """File below docs/reference -> its text."""
    made = {"cli.md": cli_page(), "python.md": python_page(), "errors.md": errors_page()}
    rows = []
    for name, title, text in formats.pages():
        made[f"formats/{name}.md"] = text
        rows.append((f"[{title}](formats/{name}.md)", _first_sentence(text)))
    lead = "These pages are written from the program itself: from its parsers, readers, signatures and error texts."
    parts = table(
        ("page", "content"),
        [
            ("[Command line](cli.md)", "Every command and every option, with defaults, examples and exit status."),
            ("[Python API](python.md)", "Every public name of `import robomill`, with types and units."),
            ("[Nomenclature](../nomenclature.md)", "Names, frames and units of everything."),
            ("[Errors](errors.md)", "Every error class with its messages, and what to do."),
        ],
    )
    made["index.md"] = page(
        "Reference", lead, parts, "## File formats", table(("format", "what it is"), rows), *(code(c, "{toctree}") for c in CONTENTS)
    )
    return made
