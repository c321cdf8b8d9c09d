"""Reading and writing the XML of a telegram in one pass over bytes, without an object per value.

The loops run compiled (`models.model.compiled`) or as plain Python. A telegram is a root element with one level below it::

    <Rob TYPE="KUKA"><AIPos A1="0.0" .../><Delay D="0" /><IPOC>4208</IPOC></Rob>

A place is a (tag, attribute) pair, or a tag alone whose text is the value.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.models.model.declaration import FloatArray, kernel

ByteArray = npt.NDArray[np.uint8]
WholeArray = npt.NDArray[np.int64]

OK, NO_ROOT, STRUCTURE, FORBIDDEN, NOT_A_NUMBER, TWICE, MISSING = range(7)
"""What `scan` returns."""
NO_ROOM, NOT_FINITE = -1, -2
"""What `write` returns instead of a length."""
WHOLE = -1
"""Instead of a number of decimals: the place holds a whole number."""
DIGITS = 18
"""Most significant digits of a number: what a signed 64-bit integer holds."""
_TOO_MUCH = 1e18
MOST_POWER = 22
"""Largest power of ten that float64 holds exactly."""
_SPACE, _TAB, _NEWLINE, _RETURN = 32, 9, 10, 13
_LESS, _GREATER, _SLASH, _EQUALS, _QUOTE, _APOSTROPHE, _AND = 60, 62, 47, 61, 34, 39, 38
_MINUS, _PLUS, _DOT, _ZERO, _NINE, _BIG_E, _SMALL_E = 45, 43, 46, 48, 57, 69, 101
_BIG_A, _BIG_Z, _SMALL_A, _SMALL_Z, _UNDERSCORE = 65, 90, 97, 122, 95
_EXPONENT = 3  # digits
_TAG, _ATTRIBUTE = 0, 1


@kernel
def after_space(b: ByteArray, p: int, end: int) -> int:
    """First position from p that holds no white space; `end` if there is none."""
    while p < end and (b[p] == _SPACE or b[p] == _TAB or b[p] == _NEWLINE or b[p] == _RETURN):
        p += 1
    return p


@kernel
def after_name(b: ByteArray, p: int, end: int) -> int:
    """First position from p that does not belong to a name: letters, digits, `_`, `-`, `.`; a name begins with a letter or `_`."""
    first = p
    while p < end:
        c = b[p]
        letter = (c >= _BIG_A and c <= _BIG_Z) or (c >= _SMALL_A and c <= _SMALL_Z) or c == _UNDERSCORE
        if not letter and (p == first or not ((c >= _ZERO and c <= _NINE) or c in (_MINUS, _DOT))):
            break
        p += 1
    return p


@kernel
def is_name(b: ByteArray, first: int, end: int, name: ByteArray, length: int) -> bool:
    """Whether the bytes from `first` to `end` are the `length` bytes of `name`."""
    if end - first != length:
        return False
    for i in range(length):  # noqa: SIM110  # compiled
        if b[first + i] != name[i]:
            return False
    return True


@kernel
def digit(c: Any) -> int:
    """Value of a digit; as a signed number, because unsigned ones become reals when they meet signed ones."""
    value = int(np.int64(c)) - _ZERO
    return value


@kernel
def number(b: ByteArray, p: int, end: int, decimals: int, values: FloatArray, wholes: WholeArray, place: int) -> int:
    """Decimal number from p to `end` into values[place] and, if it is whole, wholes[place]; OK or NOT_A_NUMBER.

    Correctly rounded for up to 15 digits, else one unit in the last place off at most. `decimals` = WHOLE: no point, no exponent.
    """
    negative = False
    if p < end and (b[p] == _MINUS or b[p] == _PLUS):
        negative = b[p] == _MINUS
        p += 1
    mantissa = 0
    digits = 0
    significant = 0
    scale = 0
    point = False
    while p < end:
        c = b[p]
        if c >= _ZERO and c <= _NINE:
            digits += 1
            if significant > 0 or c != _ZERO:
                significant += 1
                if significant > DIGITS:
                    return NOT_A_NUMBER
                mantissa = 10 * mantissa + digit(c)
            if point:
                scale -= 1
        elif c == _DOT and not point and decimals != WHOLE:
            point = True
        else:
            break
        p += 1
    if digits == 0:
        return NOT_A_NUMBER
    if p < end and (b[p] == _BIG_E or b[p] == _SMALL_E) and decimals != WHOLE:
        p += 1
        below = False
        if p < end and (b[p] == _MINUS or b[p] == _PLUS):
            below = b[p] == _MINUS
            p += 1
        exponent = 0
        first = p
        while p < end and p - first < _EXPONENT and b[p] >= _ZERO and b[p] <= _NINE:
            exponent = 10 * exponent + digit(b[p])
            p += 1
        if p == first:
            return NOT_A_NUMBER
        scale += -exponent if below else exponent
    if p != end or (mantissa != 0 and abs(scale) > MOST_POWER):
        return NOT_A_NUMBER
    power = 1.0
    for _ in range(min(abs(scale), MOST_POWER)):
        power *= 10.0
    value = float(mantissa) / power if scale < 0 else float(mantissa) * power
    values[place] = -value if negative else value
    wholes[place] = -mantissa if negative else mantissa
    return OK


@kernel
def keep(
    b: ByteArray, tag: int, tag_end: int, name: int, name_end: int, first: int, end: int, names: ByteArray, lengths: WholeArray,
    decimals: WholeArray, values: FloatArray, wholes: WholeArray, seen: WholeArray,
) -> int:  # fmt: skip
    """Store a value (bytes `first` to `end`) if its tag and attribute are a place; others are passed over."""
    for i in range(len(decimals)):
        if is_name(b, tag, tag_end, names[i, _TAG], lengths[i, _TAG]) and is_name(
            b, name, name_end, names[i, _ATTRIBUTE], lengths[i, _ATTRIBUTE]
        ):
            if seen[i] != 0:
                return TWICE
            seen[i] = 1
            return number(b, first, end, decimals[i], values, wholes, i)
    return OK


@kernel
def attributes(
    b: ByteArray, p: int, end: int, tag: int, tag_end: int, names: ByteArray, lengths: WholeArray, decimals: WholeArray,
    values: FloatArray, wholes: WholeArray, seen: WholeArray, report: WholeArray,
) -> int:  # fmt: skip
    """Read attributes from p up to `>` or `/>`; report[0] is the position there. Returns a status."""
    while True:
        before = p
        p = after_space(b, p, end)
        report[0] = p
        if p >= end:
            return STRUCTURE
        if b[p] == _GREATER or b[p] == _SLASH:
            return OK
        name = p
        name_end = after_name(b, p, end)
        if name_end == name or before == p:
            return STRUCTURE
        p = after_space(b, name_end, end)
        if p >= end or b[p] != _EQUALS:
            return STRUCTURE
        p = after_space(b, p + 1, end)
        if p >= end or (b[p] != _QUOTE and b[p] != _APOSTROPHE):
            return STRUCTURE
        quote = b[p]
        first = p + 1
        p = first
        while p < end and b[p] != quote:
            if b[p] == _LESS or b[p] == _AND:
                report[0] = p
                return FORBIDDEN
            p += 1
        if p >= end:
            return STRUCTURE
        status = keep(b, tag, tag_end, name, name_end, first, p, names, lengths, decimals, values, wholes, seen)
        if status != OK:
            report[0] = first
            return status
        p += 1


@kernel
def closing(b: ByteArray, p: int, end: int, tag: int, tag_end: int) -> int:
    """Position after `</tag>` at p, which is that of `<`; -1 if it is not there."""
    if p + 1 >= end or b[p] != _LESS or b[p + 1] != _SLASH:
        return -1
    last = after_name(b, p + 2, end)
    if last - (p + 2) != tag_end - tag:
        return -1
    for i in range(tag_end - tag):
        if b[p + 2 + i] != b[tag + i]:
            return -1
    p = after_space(b, last, end)
    return p + 1 if p < end and b[p] == _GREATER else -1


@kernel
def content(
    b: ByteArray, p: int, end: int, tag: int, tag_end: int, names: ByteArray, lengths: WholeArray, decimals: WholeArray,
    values: FloatArray, wholes: WholeArray, seen: WholeArray, report: WholeArray,
) -> int:  # fmt: skip
    """Read the text of an element from p, behind its `>`, and its end tag; report[0] is the position behind that. Returns a status."""
    first = after_space(b, p, end)
    p = first
    while p < end and b[p] != _LESS:
        if b[p] == _AND:
            report[0] = p
            return FORBIDDEN
        p += 1
    last = p
    while last > first and after_space(b, last - 1, last) == last:
        last -= 1
    report[0] = first
    if last > first:
        status = keep(b, tag, tag_end, tag_end, tag_end, first, last, names, lengths, decimals, values, wholes, seen)
        if status != OK:
            return status
    p = closing(b, p, end, tag, tag_end)
    if p < 0:
        return STRUCTURE
    report[0] = p
    return OK


@kernel
def element(
    b: ByteArray, p: int, end: int, names: ByteArray, lengths: WholeArray, decimals: WholeArray,
    values: FloatArray, wholes: WholeArray, seen: WholeArray, report: WholeArray,
) -> int:  # fmt: skip
    """Read an element without others in it, whose `<` is at p; report[0] is the position behind it. Returns a status."""
    tag = p + 1
    tag_end = after_name(b, tag, end)
    if tag_end == tag:
        return FORBIDDEN  # <!, <?
    status = attributes(b, tag_end, end, tag, tag_end, names, lengths, decimals, values, wholes, seen, report)
    if status != OK:
        return status
    p = report[0]
    if b[p] == _GREATER:
        return content(b, p + 1, end, tag, tag_end, names, lengths, decimals, values, wholes, seen, report)
    if p + 1 >= end or b[p + 1] != _GREATER:
        return STRUCTURE
    report[0] = p + 2
    return OK


def scan(
    b: ByteArray, end: int, root: ByteArray, names: ByteArray, lengths: WholeArray, decimals: WholeArray,
    values: FloatArray, wholes: WholeArray, seen: WholeArray, report: WholeArray,
) -> int:  # fmt: skip
    """Read a telegram, bytes 0 to `end` of b, into `values` and `wholes`, one per place. Returns a status; report[0]: position of a fault.

    names uint8[places, 2, length] and lengths int64[places, 2] are tags and attributes, decimals[places] is WHOLE for a whole number.
    Order and white space are free, elements that are no places are passed over. Anything of XML beyond elements, attributes and text
    is refused: declarations, document types, entities, comments.
    """
    for i in range(len(seen)):
        seen[i] = 0
    p = after_space(b, 0, end)
    report[0] = p
    top = p + 1
    if p >= end or b[p] != _LESS or not is_name(b, top, after_name(b, top, end), root, len(root)):
        return NO_ROOT
    top_end = top + len(root)
    status = attributes(b, top_end, end, top, top_end, names, lengths, decimals, values, wholes, seen, report)
    if status != OK:
        return status
    if b[report[0]] != _GREATER:
        return STRUCTURE
    report[0] += 1
    while True:
        p = after_space(b, report[0], end)
        report[0] = p
        if p + 1 >= end or b[p] != _LESS:
            return STRUCTURE
        if b[p + 1] == _SLASH:
            break
        status = element(b, p, end, names, lengths, decimals, values, wholes, seen, report)
        if status != OK:
            return status
    p = closing(b, p, end, top, top_end)
    if p < 0 or after_space(b, p, end) != end:
        return STRUCTURE
    for i in range(len(seen)):
        if seen[i] == 0:
            report[0] = i
            return MISSING
    return OK


@kernel
def put_whole(b: ByteArray, p: int, value: int, least: int) -> int:
    """Write the digits of a whole number >= 0 at p, at least so many; the position behind them, NO_ROOM if b is too short."""
    count = 1
    rest = value // 10
    while rest > 0 or count < least:
        count += 1
        rest //= 10
    if p + count > len(b):
        return NO_ROOM
    for i in range(count):
        b[p + count - 1 - i] = _ZERO + value % 10
        value //= 10
    return p + count


def write(b: ByteArray, pieces: ByteArray, starts: WholeArray, decimals: WholeArray, values: FloatArray, wholes: WholeArray) -> int:
    """Write a telegram into b and return its length, NO_ROOM or NOT_FINITE (also a number of more than DIGITS digits).

    pieces[starts[i]:starts[i + 1]] is the fixed text before place i, the last piece follows the last place. Numbers are rounded to
    decimals[i] places, halves away from zero.
    """
    p = 0
    for i in range(len(decimals) + 1):
        if p + starts[i + 1] - starts[i] > len(b):
            return NO_ROOM
        for j in range(starts[i], starts[i + 1]):
            b[p] = pieces[j]
            p += 1
        if i == len(decimals):
            break
        if p >= len(b):
            return NO_ROOM
        if decimals[i] == WHOLE:
            if wholes[i] < 0:
                b[p] = _MINUS
                p += 1
            p = put_whole(b, p, abs(wholes[i]), 1)
            if p < 0:
                return NO_ROOM
            continue
        power = 1
        for _ in range(decimals[i]):
            power *= 10
        scaled = math.fabs(values[i]) * float(power) + 0.5
        if not scaled < _TOO_MUCH:
            return NOT_FINITE
        digits = math.floor(scaled)
        if values[i] < 0.0 and digits > 0:
            b[p] = _MINUS
            p += 1
        p = put_whole(b, p, digits // power, 1)
        if p < 0 or p >= len(b):
            return NO_ROOM
        if decimals[i] > 0:
            b[p] = _DOT
            p = put_whole(b, p + 1, digits % power, decimals[i])
            if p < 0:
                return NO_ROOM
    return p
