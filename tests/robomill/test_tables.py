"""What commands print on screens of any width."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from rich.text import Text

from robomill.tables import MOST_NOTES, Content, Heading, notes, say, show

HEADINGS = [Heading("variant", "left"), Heading("max deviation\nmm"), Heading("peak force\nN"), Heading("largest at", "left", folds=True)]
ROWS: list[list[Content]] = [["uncompensated", "1.29 (1.40)", "546 (546)", "cutter entry"], ["[axis]", Text("0.77"), "549", ""]]


def shown(width: int) -> str:
    screen = Console(width=width, file=io.StringIO())
    show("Groove", HEADINGS, ROWS, screen)
    assert isinstance(screen.file, io.StringIO)
    return screen.file.getvalue()


def test_a_table_that_fits_is_one() -> None:
    lines = shown(80).splitlines()
    assert all(len(line) <= 80 for line in lines)
    (row,) = (line for line in lines if "1.29" in line)
    assert row.split() == ["uncompensated", "1.29", "(1.40)", "546", "(546)", "cutter", "entry"]


@pytest.mark.parametrize("width", [40, 50])
def test_one_that_does_not_is_a_list_in_which_nothing_is_cut(width: int) -> None:
    text = shown(width)
    assert all(len(line) <= width for line in text.splitlines())
    assert [line.rstrip() for line in text.splitlines()] == [
        "Groove",
        "",
        "uncompensated",
        "  max deviation, mm  1.29 (1.40)",
        "  peak force, N      546 (546)",
        "  largest at         cutter entry",
        "",
        "[axis]",
        "  max deviation, mm  0.77",
        "  peak force, N      549",
        "",
    ]


@pytest.mark.parametrize("width", range(50, 65))
def test_nothing_is_cut_at_the_edge_of_the_screen(width: int) -> None:
    """Where a table is a little too wide, the columns that may fold give way, and the others stay whole; else it is a list."""
    words = shown(width).replace(",", "").split()
    assert all(word in words for word in ("deviation", "force", "at", "uncompensated", "(1.40)", "(546)", "cutter", "entry", "0.77", "549"))


def test_sentences_are_whole_for_programs_and_broken_for_people(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    sentence = "nothing [in brackets] is lost " * 10
    say(sentence)
    assert capsys.readouterr().out == f"{sentence}\n"
    monkeypatch.setenv("COLUMNS", "60")
    say(sentence)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 60
    assert " ".join(" ".join(lines).split()) == sentence.strip()


def test_of_many_notes_the_first_are_printed_and_the_others_counted(capsys: pytest.CaptureFixture[str]) -> None:
    notes([f"note {i}" for i in range(MOST_NOTES + 4)], "summary.json")
    lines = capsys.readouterr().out.splitlines()
    assert lines == [*(f"note: note {i}" for i in range(MOST_NOTES)), "4 more notes are in summary.json"]
    notes(["one"], "summary.json")
    assert capsys.readouterr().out == "note: one\n"
