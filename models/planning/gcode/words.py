"""From text to words: what stands in the lines of a program, before anything means something.

Lines end with LF, CR LF or CR. Comments are ``(...)``, also nested, and ``;`` to the end of the line. Blanks and case mean nothing.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from robomill.models.planning.gcode.actions import GCodeError
from robomill.models.planning.gcode.notes import Notes

_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_EXPONENT = re.compile(r"((?:\d+\.?\d*|\.\d+)[eE][+-]\d{1,3})(?![\d.])")
"""A number with exponent, as scripts print them; an E word stands apart from the number before it."""
_CONTROL = {code: None for code in range(32) if chr(code) not in "\t\n\r"}
_COMMANDS = "$?!~"
"""First characters of lines that are commands to a control (Grbl), not part of the program."""
_CHECKSUM = re.compile(r"\*\d+$")
_TOOL_COMMENT = re.compile(
    r"\bT\s*0*(\d+)\b.*?\b(?:D|DIA|DIAM|DIAMETER|DURCHMESSER)\s*[=:]?\s*(\d+\.?\d*|\.\d+)\s*(MM|IN|\")?", re.IGNORECASE
)
_LONE_COMMENT = re.compile(r"\bTOOL DIAM(?:ETER)?\s*[=:]?\s*(\d+\.?\d*|\.\d+)\s*(MM|IN|\")?", re.IGNORECASE)
_LANGUAGES = (
    (re.compile(r"^\d*(BEGINPGM|TOOLCALL|TOOLDEF|BLKFORM|LBL|FMAX|CYCLDEF|L[XYZ][+-])"), "Heidenhain conversational programs"),
    (re.compile(r"^O(<[^>]*>|\d+)?(SUB|ENDSUB|CALL|RETURN)"), "subroutines (O-words)"),
    (
        re.compile(r"^O(<[^>]*>|\d+)(IF|ELSE|ELSEIF|ENDIF|WHILE|ENDWHILE|DO|REPEAT|ENDREPEAT|BREAK|CONTINUE|\[)"),
        "branches and loops (O-words)",
    ),
    (re.compile(r"^O<"), "subroutines (O-words)"),
    (re.compile(r"^(IF|WHILE|GOTO|END\d|DO\d|THEN|SETVN|POPEN|DPRNT|BPRNT)"), "macros: branches and loops"),
    (re.compile(r"^(MSG\(|CYCLE\d|DEF|PROC|EXTERN|WORKPIECE\(|TRANS|ATRANS|SUPA|R\d+=)"), "the language of Sinumerik controls"),
)
"""What stands at the beginning of a line that is no line of words."""
_CHARACTERS = {
    "#": "variables",
    "[": "expressions",
    "]": "expressions",
    "=": "assignments",
    "<": "named parameters",
    ",": "corner rounding or chamfer (,R ,C)",
    '"': "texts",
}


@dataclass
class Block:
    """One line: its words, and where it stands, for messages."""

    name: str
    line: int
    text: str
    number: int
    g: list[float] = field(default_factory=list)
    m: list[float] = field(default_factory=list)
    words: dict[str, float] = field(default_factory=dict)

    def error(self, found: str, supported: str) -> GCodeError:
        """An error that names this line."""
        return GCodeError(self.name, self.line, self.text, found, supported)


def decode(data: bytes) -> str:
    """Text of a program file: UTF-8 or UTF-16 by their byte order mark, UTF-8 where it is valid, else Latin-1."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.removeprefix(b"\xef\xbb\xbf").decode("latin-1")


def read_text(path: str | Path) -> tuple[str, str]:
    """Text and name of the program file `path`. FileNotFoundError if there is none."""
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"no program file {file}; expected a G-code file such as scenarios/groove.ngc")
    return decode(file.read_bytes()), file.name


def lines(text: str) -> tuple[str, ...]:
    """The lines of a program, whatever they end with; without a byte order mark and the control characters of a paper tape."""
    cleaned = text.removeprefix("\ufeff").translate(_CONTROL)
    return tuple(re.split(r"\r\n|\n|\r", cleaned.removesuffix("\n").removesuffix("\r")))


def blocks(name: str, source: tuple[str, ...], notes: Notes, block_delete: bool) -> Iterator[Block]:
    """The lines that have words, one after the other, up to the second ``%``.

    `block_delete`: lines that begin with ``/`` are skipped. GCodeError at a line that is none of words.
    """
    begun = False
    for i, text in enumerate(source, start=1):
        code = text.lstrip()
        if code[:1] == "%":
            if begun and not code[1:].strip():
                return
            begun = True
            if code[1:].strip():
                notes.skip("% line", "a comment")
            continue
        if code[:1] in _COMMANDS and code:
            notes.skip(code.split()[0], "a command to the control")
            continue
        if code[:1] == "/":
            if code[:2] == "//":
                notes.skip("// line", "a comment")
                continue
            if block_delete:
                notes.skip("/ line", "block delete; --no-block-delete executes such lines")
                continue
            code = code[1:].lstrip("123456789") if code[1:2].isdigit() else code[1:]
        block = _block(name, i, text, code)
        if block is not None:
            begun = True
            yield block


def without_comments(code: str) -> str | None:
    """The line without its comments; None where a ``(`` has no ``)``, or the other way round."""
    if "(" not in code and ")" not in code:
        return code.partition(";")[0]
    kept, depth = [], 0
    for character in code:
        if character == ";" and depth == 0:
            break
        if character == "(":
            depth += 1
        elif character == ")":
            depth -= 1
            if depth < 0:
                return None
        elif depth == 0:
            kept.append(character)
    return "".join(kept) if depth == 0 else None


def _block(name: str, line: int, text: str, code: str) -> Block | None:
    """Words of one line; None for an empty one."""
    block = Block(name, line, text, line)
    bare = without_comments(code)
    if bare is None:
        raise block.error("an unclosed comment", "a comment is written (text) on one line, or ; text to the end of the line")
    if "e" in bare or "E" in bare:
        bare = _EXPONENT.sub(lambda m: f"{float(m.group(1)):.12f}", bare)
    compact = "".join(bare.split()).upper()
    if "*" in compact:
        compact = _CHECKSUM.sub("", compact)
    if not compact:
        return None
    if compact[0] == ":":
        compact = "O" + compact[1:]
    found = _WORD.findall(compact)
    if sum(len(letter) + len(value) for letter, value in found) != len(compact):
        raise _no_words(block, compact)
    words = block.words
    for i, (letter, text_value) in enumerate(found):
        value = float(text_value)
        if letter == "G":
            block.g.append(value)
        elif letter == "M":
            block.m.append(value)
        elif letter == "N":
            if i > 0 or value < 0.0:
                raise block.error(f"'N{text_value}'", "the block number is one number at the beginning of the line")
            block.number = int(value)
        elif letter in words:
            raise block.error(f"two {letter} words", "each letter but G and M may stand once in a line")
        else:
            words[letter] = value
    return block if (block.g or block.m or words) else None


def _no_words(block: Block, compact: str) -> GCodeError:
    """The error of a line that is not made of words, with the language it seems to be of."""
    unnumbered = re.sub(r"^N\d+", "", compact)
    for pattern, language in _LANGUAGES:
        if pattern.match(unnumbered):
            return block.error(f"{unnumbered[:16]!r} ({language}: not supported)", "let the CAM system write out plain G-code")
    position = 0
    while match := _WORD.match(compact, position):
        position = match.end()
    rest = compact[position : position + 12]
    why = next((f" ({_CHARACTERS[c]}: not supported)" for c in rest if c in _CHARACTERS), "")
    return block.error(f"{rest!r}{why}", "expected words of one letter and one number, such as X12.5")


def named_diameters(source: tuple[str, ...], unit: float) -> dict[int, float]:
    """T number -> diameter [m] from comments such as ``(T1 D=6. CR=0.)``; 0 -> that of a comment without T number.

    `unit` [m]: of numbers that name none. The first comment on a tool counts.
    """
    found: dict[int, float] = {}
    for text in source:
        if ("(" in text or ";" in text) and ("D" in text or "d" in text):
            comment = text[min(i for i in (text.find("("), text.find(";")) if i >= 0) :]
            if match := _TOOL_COMMENT.search(comment):
                found.setdefault(int(match.group(1)), _length(match.group(2), match.group(3), unit))
            elif match := _LONE_COMMENT.search(comment):
                found.setdefault(0, _length(match.group(1), match.group(2), unit))
    return found


def _length(number: str, name: str | None, unit: float) -> float:
    """In metres."""
    return float(number) * ({"M": 1e-3, "I": 0.0254, '"': 0.0254}[name[0].upper()] if name else unit)
