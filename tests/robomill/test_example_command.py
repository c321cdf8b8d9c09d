"""Which texts of an example may be the names of files that come with it."""

from __future__ import annotations

import pytest

from robomill.example_command import _texts


@pytest.mark.parametrize(("length", "may_be"), [(150, True), (250, False)])
def test_a_long_text_is_no_name(length: int, may_be: bool) -> None:
    text = f"{'x' * (length - 5)}.toml"
    assert list(_texts({"part": [text]})) == [text] * may_be  # LONGEST_NAME
