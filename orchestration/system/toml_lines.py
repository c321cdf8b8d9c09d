"""Where in a TOML text each key and each element of an array stands: the parser of the standard library keeps no lines."""

from __future__ import annotations

import re
import tomllib

Key = tuple[str | int, ...]
"""("components", "drive", "source") or, in arrays, ("connections", 2, "from"), counted from zero."""

_SPACE = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_BLANK = re.compile(r"[ \t]*")
_STRING = re.compile(r'"""(?:[^\\]|\\.)*?"""(?:"{0,2})|\'\'\'.*?\'\'\'(?:\'{0,2})|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'', re.DOTALL)
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_OTHER = re.compile(r"[^,\]}#\n]+")
"""Number, boolean, date: up to what ends it."""


def key_lines(text: str) -> dict[Key, int]:
    """Line (from 1) of every key, table and array element of a valid TOML text; of a table that is opened twice, the first."""
    return _Scanner(text).lines


class _Scanner:
    """One pass over a text that `tomllib` has accepted."""

    def __init__(self, text: str) -> None:
        self.text, self.at = text, 0
        self.lines: dict[Key, int] = {}
        self._line, self._counted = 1, 0
        self._tables: dict[Key, int] = {}
        """Index of the last element of each array of tables."""
        table: Key = ()
        while self._skip(_SPACE) < len(text):
            if text[self.at] == "[":
                table = self._header()
            else:
                self._pair(table)

    def _skip(self, what: re.Pattern[str]) -> int:
        found = what.match(self.text, self.at)
        self.at = found.end() if found else self.at
        return self.at

    def _take(self, what: re.Pattern[str]) -> str:
        start = self.at
        return self.text[start : self._skip(what)]

    def _note(self, key: Key) -> None:
        self._line += self.text.count("\n", self._counted, self.at)
        self._counted = self.at
        self.lines.setdefault(key, self._line)

    def _names(self) -> list[str]:
        """A dotted key."""
        names = []
        while True:
            self._skip(_BLANK)
            quoted = self.text[self.at] in "\"'"
            part = self._take(_STRING if quoted else _BARE)
            names.append(str(tomllib.loads(f"k = {part}")["k"]) if quoted else part)
            if self.text[self._skip(_BLANK)] != ".":
                return names
            self.at += 1

    def _header(self) -> Key:
        is_array = self.text.startswith("[[", self.at)
        start = self.at
        self.at += 1 + is_array
        names = self._names()
        end, self.at = self.at + 1 + is_array, start
        table: Key = ()
        for i, name in enumerate(names):
            table = (*table, name)
            self._note(table)
            if is_array and i == len(names) - 1:
                self._tables[table] = self._tables.get(table, -1) + 1
            if table in self._tables:
                table = (*table, self._tables[table])
                self._note(table)
        self.at = end
        return table

    def _pair(self, table: Key) -> None:
        """`a.b = value`; on return behind the value."""
        start, names = self.at, self._names()
        end, self.at = self.at + 1, start
        for i in range(len(names)):
            self._note((*table, *names[: i + 1]))
        self.at = end
        self._skip(_BLANK)
        self._value((*table, *names))

    def _value(self, key: Key) -> None:
        opening = self.text[self.at]
        if opening == "[":
            self.at += 1
            index = 0
            while self.text[self._skip(_SPACE)] != "]":
                self._note((*key, index))
                self._value((*key, index))
                index += 1
                self.at = self._skip(_SPACE) + (self.text[self.at] == ",")
            self.at += 1
        elif opening == "{":
            self.at += 1
            while self.text[self._skip(_SPACE)] != "}":
                self._pair(key)
                self.at = self._skip(_SPACE) + (self.text[self.at] == ",")
            self.at += 1
        else:
            self._skip(_STRING if opening in "\"'" else _OTHER)
