"""Every error text says what to do."""

from __future__ import annotations

import ast

import pytest

from reference import error_messages
from reference.error_messages import error_classes, messages, remedy
from reference.errors import errors_page, general_remedy, without_remedy


def test_every_message_says_what_to_do() -> None:
    assert [f"{m.file}:{m.line}: {m.error}: {m.text}" for m in without_remedy()] == []


def test_messages_of_the_main_classes_are_found() -> None:
    found = {m.error for m in messages()}
    assert found >= {"ScenarioError", "SystemFileError", "LogError", "ResultsError", "CatalogueError", "SlaveError"}
    assert error_classes()["SystemFileError"].bases == ("OrchestrationError",)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("{file}: no such variant; available: {names}", "available: {names}"),
        ("the log is cut; choose another window", "choose another window"),
        ("row {n} has {k} fields; is the delimiter {d}?", "is the delimiter {d}?"),
        ("{file}: it went wrong", ""),
        ("use case {n} went wrong"[4:], ""),
    ],
)
def test_the_remedy_is_the_part_that_says_what_to_do(text: str, part: str) -> None:
    assert remedy(text) == part


def test_a_class_may_say_it_for_all_its_messages() -> None:
    assert "correct" in general_remedy("PlacedError")
    assert general_remedy("ScenarioError") == ""


def test_a_message_is_taken_from_the_source() -> None:
    tree = ast.parse('raise LogError(f"{file}: {unknown(kind, name, names)}" "; at {x}")')
    (found,) = error_messages._Finder("logs/made.py", tree).found()
    assert found.text == "{file}: unknown {what} {name}; did you mean {close}? available: {names}; at {x}"


def test_the_page_has_every_class() -> None:
    page = errors_page()
    assert all(f"## {name}\n" in page for name, c in error_classes().items() if not c.module.startswith("conformance"))
