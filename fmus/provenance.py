"""What an FMU was made of: a statement of provenance and a bill of materials, in `extra/com.github.robomill/`.

`provenance.json` is an in-toto statement (v1) with the predicate of SLSA provenance (v1); `sbom.cdx.json` is a CycloneDX 1.6 bill of
materials. Neither holds a time or a random number, so equal sources, tools and commits give equal bytes. The subjects of the
statement are the folders with what runs: a copy of the FMU that carries tables has the same ones.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from robomill.files import FILES
from robomill.fmus.reference import Related

EXTRA = "extra/com.github.robomill"
SUBJECTS = ("binaries", "sources", "resources/python")
"""Folders of the archive with what runs."""
_SOURCES = ("models", "fmus")
"""Folders of the checkout that decide what an FMU does."""


@dataclass(frozen=True)
class Material:
    """Software that an FMU holds, needs, or was made with."""

    name: str
    version: str
    licence: str
    """SPDX identifier; empty = not told."""
    scope: str
    """`required` and `optional`: where it runs; `excluded`: only where it was made (the words of CycloneDX)."""
    kind: str = "library"
    from_pypi: bool = True

    @property
    def purl(self) -> str:
        """Package URL; empty for what is on no registry that has a type for it."""
        return f"pkg:pypi/{self.name.lower().replace('_', '-')}@{self.version}" if self.from_pypi and self.version else ""


@dataclass(frozen=True)
class Origin:
    """How an FMU was made."""

    component: str
    backend: str
    fmi: str
    platforms: tuple[str, ...]
    materials: tuple[Material, ...]
    sources: Mapping[str, bytes]
    """What the model's behaviour was made from: file name -> content."""


def provenance_files(origin: Origin, content: Mapping[str, bytes]) -> tuple[dict[str, bytes], list[Related]]:
    """The two files, for an archive that holds `content`, and what the manifest says of them."""
    places = {f"{EXTRA}/provenance.json": _statement(origin, content), f"{EXTRA}/sbom.cdx.json": _bill(origin)}
    related = [
        Related(f"{EXTRA}/provenance.json", "application/vnd.in-toto+json", "meta-data", "Provenance: sources, tools and builder"),
        Related(f"{EXTRA}/sbom.cdx.json", "application/vnd.cyclonedx+json", "meta-data", "Bill of materials"),
    ]
    return {name: json.dumps(data, indent=1).encode() + b"\n" for name, data in places.items()}, related


def directory_hash(files: Mapping[str, bytes]) -> str:
    """Hexadecimal SHA-256 of the lines `<sha256 of the file>  <name>`, sorted by name: the digest `dirHash` of in-toto."""
    lines = (f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(files.items()))
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def release() -> str:
    """Version of robomill."""
    try:
        return version("robomill")
    except PackageNotFoundError:
        return "unreleased"


def material(name: str, licence: str, scope: str, kind: str = "library") -> Material:
    """An installed Python package as a material."""
    return Material(name, version(name), licence, scope, kind)


@cache
def commit() -> str:
    """Commit of the checkout; empty if there is none, or if the sources of the FMUs are not those of the commit."""

    def git(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(["git", "-C", str(FILES), *arguments], capture_output=True, text=True, check=False)

    try:
        root, head = git("rev-parse", "--show-toplevel", "HEAD").stdout.splitlines()
    except (OSError, ValueError):  # no git, no repository
        return ""
    changes = git("status", "--porcelain", "--", *_SOURCES)  # files that git does not know yet count, too
    return head if FILES.samefile(root) and changes.returncode == 0 and not changes.stdout else ""


def _statement(origin: Origin, content: Mapping[str, bytes]) -> dict[str, Any]:
    subjects = {folder: {name: data for name, data in content.items() if name.startswith(f"{folder}/")} for folder in SUBJECTS}
    sources: dict[str, Any] = {"name": "sources", "digest": {"dirHash": directory_hash(origin.sources)}}
    if commit():
        sources["digest"]["gitCommit"] = commit()
    tools = [m for m in origin.materials if m.purl and m.scope != "optional"]
    parameters = {"component": origin.component, "backend": origin.backend, "fmi": origin.fmi, "platforms": list(origin.platforms)}
    return {
        "_type": "https://in-toto.io/Statement/v1",
        "subject": [{"name": f"{folder}/", "digest": {"dirHash": directory_hash(files)}} for folder, files in subjects.items() if files],
        "predicateType": "https://slsa.dev/provenance/v1",
        "predicate": {
            "buildDefinition": {
                "buildType": "urn:robomill:build:1",
                "externalParameters": parameters,
                "resolvedDependencies": [sources, *({"uri": m.purl} for m in tools)],
            },
            "runDetails": {
                "builder": {
                    "id": "urn:robomill:build",
                    "version": {"robomill": release(), **{m.name: m.version for m in origin.materials if m.kind == "application"}},
                }
            },
        },
    }


def _bill(origin: Origin) -> dict[str, Any]:
    component = {"type": "library", "bom-ref": "fmu", "name": origin.component, "version": release(), **_licence("MIT")}
    parts = [
        {
            "type": m.kind,
            "bom-ref": m.name,
            "name": m.name,
            **({"version": m.version} if m.version else {}),
            "scope": m.scope,
            **_licence(m.licence),
            **({"purl": m.purl} if m.purl else {}),
        }
        for m in origin.materials
    ]
    tool = {"type": "application", "name": "robomill", "version": release()}
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"tools": {"components": [tool]}, "component": component},
        "components": parts,
        "dependencies": [{"ref": "fmu", "dependsOn": [m.name for m in origin.materials if m.scope != "excluded"]}],
    }


def _licence(identifier: str) -> dict[str, Any]:
    return {"licenses": [{"license": {"id": identifier}}]} if identifier else {}
