"""Broken libraries are told apart before the loader of the system meets them: it crashes on some."""

from __future__ import annotations

import struct
import sys

import pytest

from robomill.orchestration.slaves.library import problem
from tests.orchestration import c_fmu

pytestmark = pytest.mark.skipif(sys.platform != "linux" or c_fmu.compiler() is None, reason="needs Linux and a C compiler")


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    folder = tmp_path_factory.mktemp("c")
    c_fmu.build(folder)
    return (folder / "euler.so").read_bytes()


def told(tmp_path, data: bytes) -> str:
    (tmp_path / "x.so").write_bytes(data)
    return problem(tmp_path / "x.so")


def test_a_good_one(tmp_path, whole):
    assert told(tmp_path, whole) == ""


def test_other_systems(tmp_path):
    assert "is no Linux library but one for Windows" in told(tmp_path, b"MZ" + bytes(100))
    assert "is no Linux library but one for macOS" in told(tmp_path, b"\xcf\xfa\xed\xfe" + bytes(100))
    assert "is no Linux library (0 bytes" in told(tmp_path, b"")


def test_another_processor(tmp_path, whole):
    machine = 183 if whole[18] != 183 else 62
    assert "is for another processor: " in told(tmp_path, whole[:18] + struct.pack("<H", machine) + whole[20:])


def test_a_program_is_no_library(tmp_path, whole):
    assert told(tmp_path, whole[:16] + struct.pack("<H", 2) + whole[18:]) == "is not a shared library"


@pytest.mark.parametrize("share", [0.001, 0.01, 0.1, 0.5, 0.7])
def test_cut_off(tmp_path, whole, share):
    assert "cut off" in told(tmp_path, whole[: int(share * len(whole))])


def test_nothing_to_load(tmp_path, whole):
    assert told(tmp_path, whole[:56] + struct.pack("<H", 0) + whole[58:]).startswith("is damaged or cut off")
