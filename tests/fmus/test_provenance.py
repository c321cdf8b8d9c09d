"""The commit in the provenance of an FMU: that of the checkout, and only if the sources are as they were committed."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from robomill.fmus import provenance

pytestmark = pytest.mark.skipif(not shutil.which("git"), reason="needs git")


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one commit, in a folder with a blank in its name."""
    folder = tmp_path / "my checkout"
    for name in ("models", "fmus", "docs"):
        (folder / name).mkdir(parents=True)
        (folder / name / "a.py").write_text("A = 1\n")
    git(folder, "init", "--quiet")
    git(folder, "add", ".")
    git(folder, "-c", "user.name=a", "-c", "user.email=a@b", "commit", "--quiet", "--message", "one")
    monkeypatch.setattr(provenance, "FILES", folder)
    return folder


def git(folder: Path, *arguments: str) -> str:
    return subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True).stdout.strip()


def commit() -> str:
    return provenance.commit.__wrapped__()


def test_it_is_the_commit_of_the_checkout(checkout: Path) -> None:
    (checkout / "docs" / "a.py").write_text("A = 2\n")  # no source of an FMU
    assert commit() == git(checkout, "rev-parse", "HEAD")


@pytest.mark.parametrize("name", ["models/a.py", "fmus/new.py"])
def test_sources_that_are_not_committed_have_none(checkout: Path, name: str) -> None:
    (checkout / name).write_text("A = 2\n")
    assert commit() == ""
