"""Signed release archives: a zip of FMUs and packages with the checksum of each file and an Ed25519 signature of the checksums.

`SHA256SUMS` is in the form of `sha256sum`; `SHA256SUMS.sig` is the bare signature (64 bytes) of that file. So an archive can be checked
without robomill: ``sha256sum --check SHA256SUMS`` and ``openssl pkeyutl -verify -pubin -inkey public.pem -rawin -in SHA256SUMS -sigfile
SHA256SUMS.sig``. Keys are PEM files as OpenSSL writes them. Equal files and keys give equal bytes: there are no dates, and Ed25519
draws no random numbers.
"""

from __future__ import annotations

import hashlib
import re
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from robomill.fmus import archive

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

SUMS = "SHA256SUMS"
SIGNATURE = "SHA256SUMS.sig"
_LINE = re.compile(r"([0-9a-f]{64})  (.+)")


class SignatureError(ValueError):
    """An archive that is not what its maker signed, or a key that cannot be used: what, and what to do.

    Remedy: Make a key with `openssl genpkey`, or get archive and public key anew from their maker.
    """


def write_signed(file: Path, files: Mapping[str, bytes], key: Ed25519PrivateKey) -> None:
    """Write the archive `file` of `files` (name -> content), signed with a private key."""
    sums = "".join(f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(files.items())).encode()
    archive.write(file, {**files, SUMS: sums, SIGNATURE: key.sign(sums)})


def verify(file: Path, key: Path) -> list[str]:
    """Names of the files of an archive, if all are as the holder of the key signed them; `key` is the PEM file of the public key.

    SignatureError otherwise: no archive or a damaged one, not signed, signed by another key, a file changed, added or taken away.
    """
    from cryptography.exceptions import InvalidSignature

    public = _public(key)
    if not zipfile.is_zipfile(file):
        raise SignatureError(
            f"{file}: {'not a zip archive' if file.is_file() else 'no such file'}; expected one of `robomill build --sign`"
        )
    try:
        with zipfile.ZipFile(file) as opened:
            names = opened.namelist()
            twice = sorted({n for n in names if names.count(n) > 1})
            if twice:
                raise SignatureError(f"{file}: holds {', '.join(twice)} twice; get it anew from its maker")
            missing = [n for n in (SUMS, SIGNATURE) if n not in names]
            if missing:
                raise SignatureError(
                    f"{file}: without {' and '.join(missing)}, so not signed; expected an archive of `robomill build --sign`"
                )
            sums = opened.read(SUMS)
            try:
                public.verify(opened.read(SIGNATURE), sums)
            except InvalidSignature:
                raise SignatureError(
                    f"{file}: {SIGNATURE} is no signature of {SUMS} by {key}: another key signed it, or the list was changed; "
                    "ask its maker for the archive and the public key"
                ) from None
            expected = {found[2]: found[1] for line in sums.decode().splitlines() if (found := _LINE.fullmatch(line))}
            unlike = [n for n in expected if n not in names or hashlib.sha256(opened.read(n)).hexdigest() != expected[n]]
            added = [n for n in names if n not in expected and n not in (SUMS, SIGNATURE)]
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise SignatureError(f"{file}: is damaged: {error}; get it anew from its maker") from None
    if unlike or added:
        told = [f"changed or missing: {', '.join(unlike)}"] * bool(unlike) + [f"not signed: {', '.join(added)}"] * bool(added)
        raise SignatureError(f"{file}: {'; '.join(told)}; get it anew from its maker")
    return sorted(expected)


def private_key(key: Path) -> Ed25519PrivateKey:
    """The private key in a PEM file; SignatureError if there is none that can be used."""
    try:
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
        from cryptography.hazmat.primitives.serialization import load_pem_private_key
    except ImportError:
        raise _no_library() from None
    made = "make one with `openssl genpkey -algorithm ed25519 -out key.pem`"
    try:
        found = load_pem_private_key(key.read_bytes(), password=None)
    except FileNotFoundError:
        raise SignatureError(f"{key}: no such file; {made}") from None
    except (ValueError, TypeError) as error:
        raise SignatureError(f"{key}: expected a private key in PEM without a password: {error}; {made}") from None
    if not isinstance(found, Ed25519PrivateKey):
        raise SignatureError(f"{key}: the key is of another kind than Ed25519; {made}")
    return found


def _public(key: Path) -> Ed25519PublicKey:
    try:
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
        from cryptography.hazmat.primitives.serialization import load_pem_public_key
    except ImportError:
        raise _no_library() from None
    made = "its maker writes it with `openssl pkey -in key.pem -pubout -out public.pem`"
    try:
        found = load_pem_public_key(key.read_bytes())
    except FileNotFoundError:
        raise SignatureError(f"{key}: no such file; {made}") from None
    except ValueError as error:
        raise SignatureError(f"{key}: expected a public key in PEM: {error}; {made}") from None
    if not isinstance(found, Ed25519PublicKey):
        raise SignatureError(f"{key}: the key is of another kind than Ed25519; {made}")
    return found


def _no_library() -> SignatureError:
    return SignatureError("signatures need the package cryptography, which is not installed: pip install robomill[sign]")
