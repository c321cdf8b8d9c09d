"""What tests of more than one module of the orchestration need."""

import tempfile

import pytest


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """All temporary folders of a test in one place, and none left in the end."""
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    yield
    assert list(place.iterdir()) == []
