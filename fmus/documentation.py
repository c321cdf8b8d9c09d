"""documentation/ of an FMU: the component's page of equations, its ports and parameters, licences, as one HTML file."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from pathlib import Path

from robomill.files import FILES, licence
from robomill.fmus.components import companion
from robomill.fmus.interface import Interface, Port
from robomill.models.model.declaration import Model, Variable
from robomill.models.model.units import from_si

PAGES = FILES / "docs" / "components"
FEW = 6
"""Start values of an array that are listed (one per joint, say); more are looked up in modelDescription.xml."""
_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #1c2733; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { border: 1px solid #cdd5de; padding: .2rem .6rem; text-align: left; vertical-align: top; }
th { background: #eef1f5; } code, pre { background: #f4f6f8; } pre { padding: .6rem; overflow-x: auto; }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
"""


def index_html(interface: Interface, backend: str, notes: Iterable[str] = (), page: str | None = None, fmi: str = "2.0") -> str:
    """The page: what the FMU is, `page` (Markdown), ports, parameters, `notes` on use.

    Without `page` it is docs/components/<name>.md, or <name>.md beside the module of the model, if there is one.
    """
    model = interface.model
    body = [f"<h1>{escape(model.name)}</h1>", f"<p>{escape(model.description.rstrip('.'))}.</p>"]
    body.append(
        f"<p>FMI {fmi} co-simulation FMU ({escape(backend)}), made by robomill. SI units; the display units are for reading only.</p>"
    )
    if page is None:
        files = [PAGES / f"{model.name}.md", *_own_page(model)]
        page = next((f.read_text(encoding="utf-8") for f in files if f.is_file()), None)
    if page:
        first, _, rest = page.partition("\n")
        body.append(_html(rest if first.startswith("# ") else page))
    for title, ports in (("Inputs", interface.inputs), ("Outputs", interface.outputs), ("Parameters", interface.parameters)):
        if ports:
            body += [f"<h2>{title}</h2>", _table(interface, ports)]
    body += ["<h2>Use</h2>", "<ul>", *(f"<li>{escape(n)}</li>" for n in notes), "</ul>"]
    head = f'<meta charset="utf-8"><title>{escape(model.name)}</title><style>{_STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n' + "\n".join(body) + "\n</body></html>\n"


def _own_page(model: Model) -> list[Path]:
    try:
        return [companion(model, f"{model.name}.md")]
    except ValueError:  # a recording, which no module holds
        return []


def _html(markdown: str) -> str:
    try:
        from markdown_it import MarkdownIt
    except ImportError:
        return f"<pre>{escape(markdown)}</pre>"
    return str(MarkdownIt("commonmark", {"html": False}).enable("table").render(markdown))


def _table(interface: Interface, ports: tuple[Port, ...]) -> str:
    rows = ["<table><tr><th>name</th><th>unit</th><th>start</th><th>range</th><th>meaning</th></tr>"]
    for name in dict.fromkeys(p.variable for p in ports):
        v = interface.model.variable(name)
        text = v.description + (" (effect, off by default)" if v.effect else "")
        if v.causality == "output" and v.depends_on is not None:
            text += f" (follows at once: {', '.join(v.depends_on)})" if v.depends_on else " (follows no input at once)"
        shape = "" if not v.shape or v.kind == "table" else f"[{','.join(map(str, v.shape))}]"
        unit = v.unit if v.kind == "real" else v.kind
        rows.append(
            f'<tr><td><code>{escape(name + shape)}</code></td><td>{escape(unit)}</td><td class="number">{escape(_start(v))}</td>'
            f'<td class="number">{escape(_range(v))}</td><td>{escape(text)}</td></tr>'
        )
    return "\n".join([*rows, "</table>"])


def _start(v: Variable) -> str:
    if v.kind == "table":
        return "built-in rows"
    values = v.start_values.ravel()
    if len(set(values.tolist())) > 1:
        return "see modelDescription.xml" if len(values) > FEW else ", ".join(_number(x, v) for x in values)
    return _number(float(values[0]), v)


def _range(v: Variable) -> str:
    if v.kind == "table" or (v.minimum is None and v.maximum is None):
        return ""
    low = "-∞" if v.minimum is None else _number(v.minimum, v)
    return f"{low} … {'∞' if v.maximum is None else _number(v.maximum, v)}"


def _number(value: float, v: Variable) -> str:
    if v.kind == "boolean":
        return "true" if value else "false"
    text = f"{value:.6g}"
    return text + (f" ({from_si(value, v.display_unit):.6g} {v.display_unit})" if v.display_unit else "")


def licences() -> dict[str, bytes]:
    """Licence files: that of this project and those of what a backend adds."""
    return {"documentation/licenses/license.txt": licence()}
