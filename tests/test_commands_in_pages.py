"""What the pages say to type is understood: every `robomill` command in them parses, and what it copies out is an example that exists."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from robomill.cli import parser
from robomill.example_command import examples
from tests.test_docs import HISTORY, PAGES, name

BLOCK = re.compile(r"^```(?:sh|bash|console|)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINE = re.compile(r"^\s*(?:\$ )?(?:\.venv/bin/)?robomill ([a-z].*)$", re.MULTILINE)
WHERE_IT_GOES = re.compile(r"\s(?:>>?|\||&|;|#)(?:\s.*)?$")
"""Redirections, further commands and comments after a command."""


def commands(text: str) -> Iterator[list[str]]:
    """Arguments of each command in the blocks of a page; variables of a loop count as 1, continued lines as one."""
    for block in BLOCK.findall(text):
        for line in LINE.findall(block.replace("\\\n", " ")):
            yield shlex.split(re.sub(r"\$\{?\w+\}?", "1", WHERE_IT_GOES.sub("", line)))


def problem(arguments: list[str]) -> str:
    """What the command line says to it; empty where it is understood, or asks for help."""
    told = io.StringIO()
    try:
        with contextlib.redirect_stderr(told), contextlib.redirect_stdout(io.StringIO()):
            known = parser().parse_args(arguments)
    except SystemExit as end:
        return told.getvalue() if end.code else ""
    if arguments[0] == "example" and known.name is not None and known.name not in examples():
        return f"no example {known.name}"
    return ""


@pytest.mark.parametrize("page", [p for p in PAGES if not name(p).startswith(HISTORY)], ids=name)
def test_commands_of_a_page_are_understood(page: Path) -> None:
    wrong = {" ".join(c): problem(c) for c in commands(page.read_text(encoding="utf-8"))}
    assert not {command: said for command, said in wrong.items() if said}


def test_a_command_with_an_unknown_option_is_found() -> None:
    text = "```\nfor i in 1 2; do\n  robomill import map.toml log-$i.csv --out \\\n  r   # all\ndone\nrobomill run a.toml --nowhere\n```\n"
    first, second = commands(text)
    assert first == ["import", "map.toml", "log-1.csv", "--out", "r"]
    assert problem(first) == ""
    assert "unknown option '--nowhere'" in problem(second)
    assert problem(["example", "nothing"]) == "no example nothing"
