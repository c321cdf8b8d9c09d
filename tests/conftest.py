"""What all tests need."""

import os
import signal
import time

import pytest

# a shell that starts the tests in the background has SIGINT ignored; tests that press Ctrl-C need it as it is at a terminal
signal.signal(signal.SIGINT, signal.default_int_handler)

# Where COLUMNS is set, tables and sentences are broken at that width. Shells export it, and readline, which the debugger of pytest
# loads, sets it for child processes (the workers of xdist) without a change of os.environ: both are undone.
os.environ.pop("COLUMNS", None)
os.unsetenv("COLUMNS")

_START = time.monotonic()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--within", type=float, metavar="MINUTES", help="begin no test later than this; what is left is skipped and counted")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A run that is stopped from outside says nothing; one that ends in time says what passed and what was not begun."""
    minutes = item.config.getoption("--within")
    if minutes is not None and time.monotonic() - _START > 60.0 * minutes:
        pytest.skip(f"not begun within {minutes:g} minutes")
