"""`robomill completion`: what makes a shell complete commands, options, files and the names of examples."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace, _SubParsersAction
from pathlib import Path
from typing import Any

import shtab

from robomill.cli import parser
from robomill.example_command import examples


def run(options: Namespace) -> int:
    """Print the text for the shell."""
    text = script(options.shell)
    print(json.dumps({"completion": text}) if options.json else text)
    return 0


def script(shell: str) -> str:
    """The completion of all commands for a shell of `command_options.SHELLS`, as shtab writes it."""
    known = parser()
    _complete(known)
    text: str = shtab.complete(known, shell=shell)
    return text


def _complete(commands: ArgumentParser) -> None:
    """Files where an argument is a path; the names of examples."""
    for action in commands._actions:
        if isinstance(action, _SubParsersAction):
            for name, inner in action.choices.items():
                inner.complete()  # options that are added when they are used
                _complete(inner)
                if name == "example":
                    _named(inner)
        elif action.type is Path:
            completed: Any = action
            completed.complete = shtab.FILE


def _named(example: ArgumentParser) -> None:
    for action in example._actions:
        if action.dest == "name":
            action.choices = list(examples())
