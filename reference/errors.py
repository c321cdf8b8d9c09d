"""The catalogue of errors: every error class of the project, its messages, and what to do."""

from __future__ import annotations

import re
from collections.abc import Iterator

from reference.error_messages import ErrorClass, Message, error_classes, messages, remedy
from reference.markdown import page, sentence, table

INTERNAL = ("conformance",)
"""Packages whose exceptions no user sees: the battery turns them into results."""
OF_FILES = "the error of the file that is read"
_REMEDY = re.compile(r"Remedy: (.*?)(?:\n\n|$)", re.DOTALL)


def listed() -> dict[str, list[Message]]:
    """Class -> its messages as users see them; without those that pass on the text of another error."""
    found: dict[str, list[Message]] = {}
    for m in messages():
        if not m.passed_on and m.file.split("/")[0] not in INTERNAL:
            found.setdefault(m.error, []).append(m)
    return found


def general_remedy(name: str) -> str:
    """What the docstring of a class, or of a base of it, says to do."""
    known = error_classes()
    while name in known:
        if found := _REMEDY.search(known[name].docstring):
            return " ".join(found[1].split())
        name = next((b for b in known[name].bases if b in known), "")
    return ""


def errors_page() -> str:
    """All classes with all messages."""
    lead = (
        "Every message says what is wrong, which value was found, and what to do. `{...}` stands for what differs from case to case. "
        "The command line prints the message and ends with status 2. In Python the class tells what to catch."
    )
    known = {n: c for n, c in error_classes().items() if c.module.split(".")[0] not in INTERNAL}
    found = listed()
    index = table(("class", "what it is about"), ((f"[`{n}`](#{n.lower()})", _about(c)) for n, c in sorted(known.items())))
    parts = [*(_section(c, found.get(n, [])) for n, c in sorted(known.items()))]
    if OF_FILES in found:
        parts.append(f"## Files\n\nRaised with the class of the file that is read.\n\n{_rows(found[OF_FILES], '')}")
    return page("Errors", lead, index, *parts)


def _about(c: ErrorClass) -> str:
    return sentence(_REMEDY.sub("", c.docstring).strip().split("\n\n")[0])


def _section(c: ErrorClass, found: list[Message]) -> str:
    where = f"`robomill.{c.module.removeprefix('robomill.')}`, derived from {', '.join(f'`{b}`' for b in c.bases)}."
    general = general_remedy(c.name)
    return "\n\n".join(
        filter(None, [f"## {c.name}", _about(c), where, f"Remedy: {sentence(general)}" if general else "", _rows(found, general)])
    )


def _rows(found: list[Message], general: str) -> str:
    return table(("message", "what to do"), dict.fromkeys(_row(m, general) for m in found))


def _row(m: Message, general: str) -> tuple[str, str]:
    return f"`{_plain(m.text)}`", f"`{_plain(remedy(m.text))}`" if remedy(m.text) else "as above" if general else ""


def _plain(text: str) -> str:
    return " ".join(text.replace("`", "'").split())


def without_remedy() -> Iterator[Message]:
    """Messages that do not say what to do, of classes that do not say it for all of theirs."""
    for name, found in listed().items():
        for m in found:
            if not remedy(m.text) and not general_remedy(name):
                yield m
