"""Messages about names and files of any length stay readable; errors go from one process to another."""

from __future__ import annotations

import pickle
import signal
from pathlib import Path

import pytest

from robomill.orchestration.errors import (
    Interrupted,
    IterationError,
    MissingPackageError,
    OrchestrationError,
    PlacedError,
    RunError,
    SystemFileError,
    WiringError,
    shortened,
    unknown,
)
from robomill.orchestration.slaves import archive
from robomill.orchestration.ssp.files import Files
from robomill.orchestration.system.definition import ticks


def test_a_text_is_shortened_only_if_it_is_too_long() -> None:
    assert shortened("abcd", 4) == "abcd"
    assert shortened("abcde", 4) == "abcd..."


@pytest.mark.parametrize(("length", "shown"), [(150, 150), (300, 200)])
def test_a_name_that_does_not_exist(length: int, shown: int) -> None:
    assert unknown("part", length * "x", ["a"]).count("x") == shown  # MAX_WRONG_NAME


@pytest.mark.parametrize(("length", "shown"), [(100, 100), (200, 120)])
def test_an_entry_of_an_archive(length: int, shown: int) -> None:
    assert archive._short(length * "x").count("x") == shown  # _SHOWN


@pytest.mark.parametrize(("length", "shown"), [(1400, 1400), (2000, 1500)])
def test_a_message_about_a_package(length: int, shown: int) -> None:
    assert str(Files(Path("a.ssp"), Path(), set()).fail(length * "x")).count("x") == shown  # MAX_MESSAGE


def test_times_are_below_thirty_years() -> None:
    assert ticks(0.9e9, "step") == 900_000_000_000_000_000
    with pytest.raises(SystemFileError, match="is not a number of seconds below"):
        ticks(1.5e9, "step")  # MAX_SECONDS


@pytest.mark.parametrize(
    "error",
    [
        RunError("component 'plant' failed", "plant", 0.25, Path("results")),
        Interrupted(0.5, None, signal.SIGTERM),
        IterationError("no convergence", "plant"),
        WiringError(["one", "two"]),
        PlacedError("too large", "a.toml:3"),
        MissingPackageError("no package"),
    ],
    ids=lambda e: type(e).__name__,
)
def test_an_error_goes_to_another_process_with_all_that_it_knows(error: OrchestrationError) -> None:
    there = pickle.loads(pickle.dumps(error))
    assert type(there) is type(error)
    assert str(there) == str(error)
    assert vars(there) == vars(error)
