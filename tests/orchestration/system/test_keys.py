"""Declared keys: what is required, what counts where nothing is written, and the errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomill.orchestration.system import keys
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required


class Inner(Keys):
    """An inner table."""

    begin = required(keys.count(1), "where it begins", name="from")


class Outer(Keys):
    """An outer table."""

    step = required(keys.number(), "the step")
    mode = default("slow", keys.choice(("slow", "fast")), "how")
    title = optional(keys.text(), "what it is called")
    inner = default({"from": 3}, keys.table(Inner), "one table")
    listed = default([], keys.each(Inner), "several tables")
    called = default({}, keys.tables(Inner), "tables by name")


class Further(Outer):
    """More keys."""

    more = default(False, keys.flag(), "whether there is more")


def read(text: str) -> Entry:
    return Entry.read(text, "x.toml", Path(), ValueError)


def test_values_and_what_counts_where_none_is_written() -> None:
    top = Outer.of(read("step = 2\n[called.a]\nfrom = 5\n"))
    assert (Outer.step.of(top), Outer.mode.of(top), Outer.title.of(top)) == (2.0, "slow", None)
    assert Inner.begin.of(Outer.inner.of(top)) == 3
    assert Outer.listed.of(top) == []
    assert {name: Inner.begin.of(e) for name, e in Outer.called.of(top).items()} == {"a": 5}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mode = 'slow'", r"x.toml: missing: step; known keys: called, inner, listed, mode, step, title"),
        ("step = 1\nmodes = 2", r"x.toml:2: modes: unknown key 'modes'; did you mean 'mode'\? available: called, inner"),
    ],
)
def test_a_table_with_other_keys_is_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Outer.of(read(text))


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        (Outer.mode, "mode = 'quick'", "x.toml:1: mode: unknown mode 'quick'"),
        (Outer.inner, "[inner]\nfrom = 0", None),
        (Outer.listed, "[[listed]]\nto = 1", "x.toml:2: listed 1: to: unknown key 'to'"),
    ],
)
def test_a_value_that_is_not_of_the_kind_is_refused(key: keys.Key[object], text: str, said: str | None) -> None:
    top = read(text)
    if said is None:
        with pytest.raises(ValueError, match="from: expected a whole number, at least 1; found 0"):
            Inner.begin.of(Outer.inner.of(top))
        return
    with pytest.raises(ValueError, match=said):
        key.of(top)


def test_own_keys_come_before_those_of_the_base() -> None:
    assert list(Further.all()) == ["more", "step", "mode", "title", "inner", "listed", "called"]
