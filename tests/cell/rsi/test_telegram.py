"""Telegrams: what is written is read back, and nothing but telegrams is read."""

from __future__ import annotations

import random
from xml.etree import ElementTree

import numpy as np
import pytest

from robomill.cell.rsi import telegram_kernels as kernels
from robomill.cell.rsi.telegram import LONGEST, WHOLE, Place, Telegram, TelegramError
from tests.tolerances import EXACT, ROUNDOFF

NAMES = [*(f"AIPos.A{i}" for i in range(1, 7)), "Force.X", "Force.Y", "FTC", "Delay.D"]
GOOD = b'<Rob TYPE="KUKA"><A X="1.5" Y="-2" /><B>7</B><IPOC>12</IPOC></Rob>'


def small() -> Telegram:
    return Telegram("Rob", 'TYPE="KUKA"', [Place("A.X"), Place("A.Y"), Place("B", WHOLE)])


def status(text: bytes) -> tuple[int, str]:
    t = small()
    found = t.read(t.put(text))
    return found, t.explain(found) if found else ""


@pytest.mark.parametrize("decimals", [0, 4, 9])
def test_what_is_written_is_read_back_to_its_decimals(decimals: int) -> None:
    t = Telegram("Rob", 'TYPE="KUKA"', [Place(n, WHOLE if n == "Delay.D" else decimals) for n in NAMES])
    rng = np.random.default_rng(1)
    for _ in range(50):
        wanted = rng.normal(size=len(NAMES)) * 10.0 ** rng.integers(-6, 7, len(NAMES))
        t.values[:-1], t.wholes[-2], t.ipoc = wanted, -17, 4_208_004
        n = t.write()
        text = bytes(t.view(n))
        root = ElementTree.fromstring(text)  # an independent reader
        assert root.attrib == {"TYPE": "KUKA"}
        assert root.findtext("IPOC") == "4208004"
        assert t.read(n) == kernels.OK
        assert (t.ipoc, t.wholes[-2]) == (4_208_004, -17)
        for name, value, read in zip(NAMES[:-1], wanted[:-1], t.values, strict=False):
            tag, _, attribute = name.partition(".")
            element = root.find(tag)
            assert element is not None
            written = float(element.get(attribute, "") if attribute else element.text or "")
            assert read == pytest.approx(written, rel=ROUNDOFF, abs=EXACT)
            assert read == pytest.approx(value, rel=ROUNDOFF, abs=0.5 * 10.0**-decimals * (1.0 + ROUNDOFF))


@pytest.mark.parametrize(
    "text", ["0", "-0", "1.", ".5", "+2.50", "1e3", "-1.25E-2", "123456789012345", "0.000000000001", "000000000000000000001"]
)
def test_numbers_are_those_of_python(text: str) -> None:
    t = small()
    assert t.read(t.put(GOOD.replace(b"1.5", text.encode()))) == kernels.OK
    assert t.values[0] == float(text)


@pytest.mark.parametrize(
    "text", ["", "-", ".", "nan", "inf", "1,5", "1.5.2", "0x10", "1e", "1e99", "12345678901234567890", " 1", "1 ", "--1"]
)
def test_what_is_no_number_is_refused(text: str) -> None:
    found, said = status(GOOD.replace(b"1.5", text.encode()))
    assert found == kernels.NOT_A_NUMBER
    assert said == "the value at byte 23 is not a decimal number of at most 18 digits"


def test_order_white_space_and_unknown_elements_are_free() -> None:
    t = small()
    text = b"""
      <Rob TYPE = 'KUKA' >
        <IPOC> 12 </IPOC><Tech C11="x" C12="0.0"/><Text>hello</Text>
        <B>7</B>  <A Y="-2" More="1" X="1.5"></A>
      </Rob>
    """
    assert t.read(t.put(text)) == kernels.OK
    np.testing.assert_array_equal(t.values, [1.5, -2.0, 7.0, 12.0])


STRAY = "a declaration, comment, entity or stray < at byte {}; only elements with attributes or text are read"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"", "the XML is broken at byte 0"),
        (b"\0\0\0", "it does not begin with <Rob"),
        (GOOD.replace(b"Rob", b"Sen"), "it does not begin with <Rob"),
        (GOOD[:-1], "the XML is broken at byte 60"),
        (GOOD[:30], "the XML is broken at byte 28"),
        (GOOD + GOOD, "the XML is broken at byte 60"),
        (GOOD.replace(b"</B>", b"</C>"), "the XML is broken at byte 40"),
        (GOOD.replace(b"<B>7</B>", b""), "B is missing"),
        (GOOD.replace(b"<B>7</B>", b"<B>7</B><B>7</B>"), "the value at byte 48 is there twice"),
        (GOOD.replace(b"<B>7", b"<B>7.0"), "the value at byte 40 is not a decimal number of at most 18 digits"),
        (b'<?xml version="1.0"?>' + GOOD, "it does not begin with <Rob"),
        (b'<!DOCTYPE Rob [<!ENTITY e "1">]>' + GOOD, "it does not begin with <Rob"),
        (GOOD.replace(b"1.5", b"&e;"), STRAY.format(23)),
        (GOOD.replace(b"<B>", b"<!-- --><B>"), STRAY.format(37)),
        (GOOD + b" " * LONGEST, f"the XML is broken at byte {LONGEST}"),
    ],
)  # fmt: skip
def test_what_is_no_telegram_is_refused_and_said(text: bytes, said: str) -> None:
    assert status(text)[1] == said


def test_damage_never_does_more_than_be_refused() -> None:
    rng = random.Random(7)
    t, refused = small(), 0
    for _ in range(3000):
        text = bytearray(GOOD)
        for _ in range(rng.randint(1, 4)):
            text[rng.randrange(len(text))] = rng.randrange(256)
        found = t.read(t.put(bytes(text[: rng.randint(0, len(text))])))
        refused += found != kernels.OK
        assert found == kernels.OK or t.explain(found)
        assert np.all(np.isfinite(t.values))
    assert refused > 2500


def test_plain_python_reads_and_writes_the_same() -> None:
    t = small()
    n = t.put(GOOD)
    assert t.read(n) == kernels.OK
    values, wholes = t.values.copy(), t.wholes.copy()
    arguments = (t._root, t._names, t._lengths, t._decimals, t.values, t.wholes, t._seen, t._report)
    t.values[:] = 0.0
    assert kernels.scan(t._bytes, n, *arguments) == kernels.OK
    np.testing.assert_array_equal(t.values, values)
    length = t.write()
    text = bytes(t.view(length))
    assert kernels.write(t._bytes, t._pieces, t._starts, t._decimals, values, wholes) == length
    assert bytes(t.view(length)) == text


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e15])
def test_a_number_that_cannot_be_sent_is_an_error(value: float) -> None:
    t = small()
    t.values[0] = value
    with pytest.raises(TelegramError, match=r"<Rob> cannot be written: A.X = .*expected finite numbers of at most 18 digits"):
        t.write()


def test_a_name_is_one_value() -> None:
    with pytest.raises(TelegramError, match=r"<Rob>: A.X twice; a name is one value"):
        Telegram("Rob", "", [Place("A.X"), Place("A.X")])
