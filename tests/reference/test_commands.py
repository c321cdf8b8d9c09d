"""Every command has an example that its parser takes, and every option a text."""

from __future__ import annotations

import argparse
import re
import shlex

import pytest

from reference.commands import cli_page, commands, example
from robomill.cli import parser
from tests import ROOT


def test_every_option_has_a_text() -> None:
    assert [f"{c.prog} {a.dest}" for c in commands() for a in c._actions if not a.help] == []


@pytest.mark.parametrize("command", list(commands()), ids=lambda c: c.prog)
def test_the_example_is_one_of_the_command(command: argparse.ArgumentParser) -> None:
    words = shlex.split(example(command))
    assert " ".join(words).startswith(command.prog + " ")
    parser().parse_args(words[1:])
    named = [w for w in words if re.match(r"(scenarios|data)/", w)]
    assert [w for w in named if not (ROOT / w).is_file()] == []


def test_a_default_in_the_text_has_a_column_of_its_own() -> None:
    assert "| `--out OUT` | results/NAME | Folder for the results. |" in cli_page()
