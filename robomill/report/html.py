"""Pieces of the page: tables, figures, bars, paragraphs, as HTML without scripts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape

from robomill.report.units import percent


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numeric: Sequence[int] = ()) -> str:
    """Cells are HTML already; columns in `numeric` are set flush right. A row of one cell is a heading.

    On a narrow page each row is a block, and each cell has its heading beside it.
    """
    heads = "".join(f'<th class="n">{c}</th>' if i in numeric else f"<th>{c}</th>" for i, c in enumerate(head))

    def row(cells: Sequence[str]) -> str:
        if len(cells) == 1:
            return f'<tr class="group"><th colspan="{len(head)}">{cells[0]}</th></tr>'
        return "<tr>" + "".join(_cell(name, c, i in numeric) for i, (name, c) in enumerate(zip(head, cells, strict=True))) + "</tr>"

    body = "\n".join(map(row, rows))
    return f'<div class="scroll"><table>\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'


def _cell(name: str, content: str, numeric: bool) -> str:
    kind = " ".join([*(["n"] if numeric else []), *(["dash"] if content in ("–", "") else [])])
    return f'<td{_class(kind)} data-label="{escape(name)}"><div>{content}</div></td>'


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def figure(figures: Mapping[str, str], name: str, caption: str) -> str:
    """The figure of that name with its caption; nothing where the answer has no such figure."""
    return f"<figure>\n{figures[name]}\n<figcaption>{escape(caption)}</figcaption>\n</figure>" if name in figures else ""


def bar(share: float) -> str:
    """A share as a bar and a number."""
    width = 100.0 * min(max(share, 0.0), 1.0)
    return (
        f'<span class="share"><span class="bar" aria-hidden="true"><span style="width: {width:.1f}%"></span></span>{percent(share)}</span>'
    )


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of a class."""
    return f"<p{_class(kind)}>{escape(text)}</p>"


def code(text: str) -> str:
    """A name, that may be broken where its parts meet."""
    return "<code>" + escape(text).replace(".", ".<wbr/>") + "</code>"


def fold(title: str, body: str, *, unfolded: bool = False) -> str:
    """What is shown when it is asked for."""
    return f"<details{' open=' + chr(34) + 'open' + chr(34) if unfolded else ''}><summary>{escape(title)}</summary>\n{body}\n</details>"


def count(n: int, what: str) -> str:
    """`1 run`, `2 runs`."""
    return f"{n} {what}{'' if n == 1 else 's'}"
