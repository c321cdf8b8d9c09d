"""Signed release archives: what was changed, added, taken away or signed by somebody else is told, and OpenSSL agrees."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from robomill.fmus.signed import SIGNATURE, SUMS, SignatureError, private_key, verify, write_signed

serialization = pytest.importorskip("cryptography.hazmat.primitives.serialization")
ed25519 = pytest.importorskip("cryptography.hazmat.primitives.asymmetric.ed25519")
FILES = {"robot_drive.fmu": b"drive" * 100, "fmi3/robot_drive.fmu": b"3", "groove.ssp": b""}


def pem(key: Any) -> bytes:
    raw: bytes = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    return raw


def public_pem(key: Any) -> bytes:
    raw: bytes = key.public_key().public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    return raw


@pytest.fixture
def keys(tmp_path: Path) -> tuple[Path, Path]:
    """A private and a public key, the same in every run."""
    key = ed25519.Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
    (tmp_path / "key.pem").write_bytes(pem(key))
    (tmp_path / "public.pem").write_bytes(public_pem(key))
    return tmp_path / "key.pem", tmp_path / "public.pem"


@pytest.fixture
def archive(keys: tuple[Path, Path], tmp_path: Path) -> Path:
    write_signed(tmp_path / "release.zip", FILES, private_key(keys[0]))
    return tmp_path / "release.zip"


def rewritten(archive: Path, change: Mapping[str, bytes | None]) -> Path:
    """A copy with some files replaced, added, or (None) taken away."""
    with zipfile.ZipFile(archive) as source:
        content: dict[str, bytes | None] = {n: source.read(n) for n in source.namelist()}
    made = archive.with_name("changed.zip")
    with zipfile.ZipFile(made, "w") as target:
        for name, data in (content | dict(change)).items():
            if data is not None:
                target.writestr(name, data)
    return made


def test_what_was_signed_is_accepted_and_comes_out_the_same_every_time(archive: Path, keys: tuple[Path, Path], tmp_path: Path) -> None:
    assert verify(archive, keys[1]) == sorted(FILES)
    write_signed(tmp_path / "again.zip", FILES, private_key(keys[0]))
    assert (tmp_path / "again.zip").read_bytes() == archive.read_bytes()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"robot_drive.fmu": b"other"}, r"changed\.zip: changed or missing: robot_drive\.fmu; get it anew"),
        ({"groove.ssp": None}, r"changed or missing: groove\.ssp"),
        ({"evil.fmu": b"x"}, r"not signed: evil\.fmu"),
        ({SIGNATURE: None}, r"without SHA256SUMS\.sig, so not signed"),
        ({SUMS: b"0" * 64 + b"  robot_drive.fmu\n"}, r"is no signature of SHA256SUMS by .*public\.pem: another key signed it"),
    ],
)
def test_any_change_is_told(change: Mapping[str, bytes | None], text: str, archive: Path, keys: tuple[Path, Path]) -> None:
    with pytest.raises(SignatureError, match=text):
        verify(rewritten(archive, change), keys[1])


def test_a_damaged_archive_is_told(archive: Path, keys: tuple[Path, Path]) -> None:
    data = bytearray(archive.read_bytes())
    with zipfile.ZipFile(archive) as opened:
        entry = opened.getinfo("robot_drive.fmu")
    data[entry.header_offset + 30 + len(entry.filename) + entry.compress_size // 2] ^= 0xFF  # a local header of a zip has 30 bytes
    archive.write_bytes(data)
    with pytest.raises(SignatureError, match=r"release\.zip: is damaged: .*; get it anew from its maker"):
        verify(archive, keys[1])


def test_another_key(archive: Path, tmp_path: Path) -> None:
    (tmp_path / "other.pem").write_bytes(public_pem(ed25519.Ed25519PrivateKey.from_private_bytes(bytes(32))))
    with pytest.raises(SignatureError, match=r"is no signature of SHA256SUMS by .*other\.pem"):
        verify(archive, tmp_path / "other.pem")


def test_what_is_no_archive_and_no_key(keys: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "text").write_text("hello")
    with pytest.raises(SignatureError, match=r"text: not a zip archive; expected one of `robomill build --sign`"):
        verify(tmp_path / "text", keys[1])
    with pytest.raises(SignatureError, match=r"none\.zip: no such file"):
        verify(tmp_path / "none.zip", keys[1])
    with pytest.raises(SignatureError, match=r"text: expected a private key in PEM .*make one with `openssl genpkey"):
        private_key(tmp_path / "text")
    with pytest.raises(SignatureError, match=r"none\.pem: no such file; its maker writes it with `openssl pkey"):
        verify(tmp_path / "text", tmp_path / "none.pem")


@pytest.mark.skipif(not shutil.which("openssl"), reason="needs openssl")
def test_openssl_accepts_the_signature(archive: Path, keys: tuple[Path, Path], tmp_path: Path) -> None:
    with zipfile.ZipFile(archive) as opened:
        opened.extractall(tmp_path / "opened")
    command = ["openssl", "pkeyutl", "-verify", "-pubin", "-inkey", str(keys[1]), "-rawin", "-in", SUMS, "-sigfile", SIGNATURE]
    done = subprocess.run(command, cwd=tmp_path / "opened", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
