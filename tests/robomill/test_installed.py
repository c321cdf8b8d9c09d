"""What is installed, by the names of folders: the same as importlib.metadata says."""

from __future__ import annotations

import sys
from importlib import metadata
from pathlib import Path

import pytest

from robomill import installed


def test_versions_are_those_of_importlib_metadata() -> None:
    names = {d.name for d in metadata.distributions()}
    assert len(names) > 10
    assert {n: installed.version(n) for n in names} == {n: metadata.version(n) for n in names}


def test_what_is_not_installed_is_the_error_of_importlib_metadata() -> None:
    with pytest.raises(metadata.PackageNotFoundError, match="no_such_package"):
        installed.version("no_such_package")


@pytest.mark.parametrize(("text", "found"), [("[some.group]\nx = a:b\n", True), ("[other]\nx = a:b\n", False)])
def test_a_group_is_offered_where_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, found: bool) -> None:
    folder = tmp_path / "pack-1.0.dist-info"
    folder.mkdir()
    (folder / "entry_points.txt").write_text(text, encoding="utf-8")
    (tmp_path / "other-1.0.dist-info").mkdir()
    monkeypatch.setattr(sys, "path", [str(tmp_path), str(tmp_path / "missing")])
    assert installed.may_offer("some.group") is found


def test_an_archive_on_the_search_path_may_offer_anything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive = tmp_path / "pack.zip"
    archive.write_bytes(b"")
    monkeypatch.setattr(sys, "path", [str(archive)])
    assert installed.may_offer("some.group")
