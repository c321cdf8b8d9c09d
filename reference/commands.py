"""The page of the command line, from the argument parsers."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator

from reference.markdown import code, page, sentence, table
from robomill.cli import Parser, parser

_DEFAULT = re.compile(r"\s*\(default: ((?:[^()]|\([^()]*\))*)\)")
_EXAMPLE = re.compile(r"Example: (.*)", re.DOTALL)


def commands() -> Iterator[argparse.ArgumentParser]:
    """The parser of every command that does something, those of several steps step by step."""
    yield from _leaves(parser())


def _leaves(made: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    if isinstance(made, Parser):
        made.complete()
    below = next((a for a in made._actions if isinstance(a, argparse._SubParsersAction)), None)
    if below is None:
        yield made
    else:
        for command in dict.fromkeys(below.choices.values()):
            yield from _leaves(command)


def example(command: argparse.ArgumentParser) -> str:
    """Its example, one line; empty where it has none."""
    found = _EXAMPLE.search(command.epilog or "")
    return " ".join(found[1].split()) if found else ""


def cli_page() -> str:
    """All commands with their options."""
    top = parser()
    lead = f"{sentence(str(top.description))}\n\n{sentence(str(top.epilog))}"
    listed = table(("command", "what it does"), ((f"[`{c.prog}`](#{_anchor(c)})", sentence(str(c.description))) for c in commands()))
    return page("Command line", lead, listed, *(_section(c) for c in commands()))


def _anchor(command: argparse.ArgumentParser) -> str:
    return command.prog.replace(" ", "-")


def _section(command: argparse.ArgumentParser) -> str:
    actions = [a for a in command._actions if not isinstance(a, argparse._HelpAction) and a.help is not argparse.SUPPRESS]
    positional = [a for a in actions if not a.option_strings]
    options = [a for a in actions if a.option_strings]
    required = [f" {a.option_strings[0]} {_value(a)}" for a in options if a.required]
    usage = f"{command.prog}{''.join(required)}{''.join(f' {_taken(a)}' for a in positional)}{' [OPTIONS]' if options else ''}"
    parts = [f"## {command.prog}", sentence(str(command.description)), code(usage, "text")]
    if positional:
        parts.append(table(("argument", "default", "meaning"), ((f"`{_value(a)}`", *_meaning(a)) for a in positional)))
    if options:
        parts.append(table(("option", "default", "meaning"), ((f"`{_option(a)}`", *_meaning(a)) for a in options)))
    parts.append(f"Example:\n\n{code(example(command), 'sh')}")
    return "\n\n".join(parts)


def _option(action: argparse.Action) -> str:
    value = _value(action)
    return ", ".join(action.option_strings) + (f" {value}" if value else "")


def _taken(action: argparse.Action) -> str:
    """How a positional argument is written in the usage."""
    value = _value(action)
    return {"?": f"[{value}]", "*": f"[{value} ...]", "+": f"{value} [...]"}.get(str(action.nargs), value)


def _value(action: argparse.Action) -> str:
    """What stands for the value; nothing for a flag."""
    if action.nargs == 0:
        return ""
    if isinstance(action.metavar, tuple):
        return " ".join(action.metavar)
    if action.choices is not None and action.metavar is None:
        name = "|".join(map(str, action.choices))
    else:
        name = action.metavar or action.dest.upper()
    many = action.option_strings and (action.nargs in ("+", "*"))
    optional = bool(action.option_strings) and action.nargs == "?"
    return f"[{name}]" if optional else f"{name} ..." if many else name


def _meaning(action: argparse.Action) -> tuple[str, str]:
    """Default and meaning; the default is what the help text says, or else the value."""
    text = str(action.help or "")
    said = _DEFAULT.search(text)
    text = _DEFAULT.sub("", text)
    default = said[1] if said else "required" if action.required and action.option_strings else ""
    if not default and action.default not in (None, False, [], argparse.SUPPRESS):
        default = f"`{action.default}`"
    text = sentence(text)
    if isinstance(action, argparse._AppendAction) and "repeated" not in text:
        text += " May be repeated."
    return default, text
