"""Tables as a notebook shows them (`_repr_html_`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

MOST_ROWS = 40
"""Rows that a notebook shows of one table; what is beyond is counted."""


def table(caption: str, headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """HTML of a table; all texts are escaped. Of more than MOST_ROWS rows the first are shown, and the others counted."""
    listed = [list(row) for row in rows]
    head = "".join(f"<th style='text-align:left'>{escape(h)}</th>" for h in headings)
    body = "".join(_row(row) for row in listed[:MOST_ROWS])
    if len(listed) > MOST_ROWS:
        body += f"<tr><td colspan='{len(headings)}'>and {len(listed) - MOST_ROWS} more</td></tr>"
    title = f"<caption style='text-align:left'>{escape(caption)}</caption>"
    return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def paragraphs(texts: Iterable[str]) -> str:
    """HTML of sentences, one below the other."""
    return "".join(f"<p>{escape(text)}</p>" for text in texts)


def escape(text: str) -> str:
    """The text with entities for what has a meaning in HTML."""
    import html  # the names of all entities come with it, and only a notebook needs them

    return html.escape(text)


def _row(cells: Sequence[object]) -> str:
    return "<tr>" + "".join(f"<td style='text-align:left'>{escape(str(c))}</td>" for c in cells) + "</tr>"
