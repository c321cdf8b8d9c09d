"""Builds the Python FMU of a model: pythonfmu's library, our own slave, model description and packaging.

The archive holds modelDescription.xml, binaries/, documentation/, terminalsAndIcons/, extra/, model.png and in resources/

    slavemodule.txt                     names the entry point for the library
    slave_<hash>.py                     entry point: loads the package below
    python/robomill_<hash>/             the model's sources, data and tables, under a name that no other FMU has
    tables/<name>.npy                   built-in rows of the tables, to look at and to start from

The hash is that of the content. FMUs in one process share `sys.modules`; two versions of a
component, or this project's own `models`, would otherwise run each other's code.
"""

from __future__ import annotations

import ast
import hashlib
import io
import json
from collections.abc import Mapping
from importlib.metadata import distribution, version
from pathlib import Path, PurePosixPath
from uuid import UUID

import numpy as np

from robomill.fmus import archive, probe
from robomill.fmus.components import home
from robomill.fmus.documentation import index_html, licences
from robomill.fmus.fmi2 import model_description_2
from robomill.fmus.interface import Interface
from robomill.fmus.model_description import Options
from robomill.fmus.provenance import Origin, material, provenance_files, release
from robomill.fmus.reference import experiment_files, manifest_files, reference_files
from robomill.fmus.terminals import terminal_files
from robomill.models.components.correction import CorrectionModel
from robomill.models.components.recording import ReplayModel
from robomill.models.model.cache import source_files
from robomill.models.model.calls import check_kernels
from robomill.models.model.declaration import FloatArray, Model
from robomill.models.model.parameters import DATA

PLATFORMS = {"linux64": "libpythonfmu-export.so", "win64": "pythonfmu-export.dll"}
RUNTIME = "robomill.fmus.python.slave"
_INSTALLER = "robomill.fmus.python.install"

SCRIPT = '''"""Entry point of this FMU for the pythonfmu library, which runs it once per instance. Loads the package beside it."""

import ctypes
import importlib.util
import os
import sys

PACKAGE = "{package}"


def load():
    """The slave class.

    The folder that the library put on sys.path is taken off again: nothing is to be found through it.
    With every instance the library gives up a reference to the globals of this module that it does not have.
    """
    sys.path[:] = [p for p in sys.path if not os.path.isfile(os.path.join(p, "slave_" + PACKAGE + ".py"))]
    if PACKAGE not in sys.modules:
        bundle = os.path.join(os.path.dirname(__file__), "python", PACKAGE)
        file = os.path.join(bundle, "robomill", "fmus", "python", "install.py")
        spec = importlib.util.spec_from_file_location(PACKAGE + "_install", file)
        installer = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(installer)
        installer.install(PACKAGE, bundle)
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))
    return sys.modules[PACKAGE].ComponentSlave


ComponentSlave = load()
'''

PACKAGE_INIT = '''"""{description}."""

{imports}
from robomill.fmus.python.slave import slave_class

ComponentSlave = slave_class(MODEL, "{package}")
'''

REPLAY_IMPORTS = """import json
from pathlib import Path, PurePosixPath

import numpy as np

from robomill.models.components.recording import from_specification

_FOLDER = Path(__file__).parent
MODEL = from_specification(json.loads((_FOLDER / "replay.json").read_text()), np.load(_FOLDER / "recording.npy"))
"""

FORM_IMPORTS = """from pathlib import Path

from robomill.models.components.correction import read_form

MODEL = read_form(Path(__file__).parent / "law.form.json")
"""

NOTES = (
    "Needs Python 3.11 or newer with NumPy in the importing process, and the packages that the component's own sources import; "
    "Numba makes it some 100 times faster.",
    "linux64 and win64. An importer that is not itself Python must find libpython (LD_PRELOAD on Linux).",
    "The path it is unpacked to may hold ASCII letters and blanks; the library does not decode other escapes of the resource URI.",
    "An error ends in fmi2Fatal with its text in the log and on stderr; the instance can be reset or freed afterwards.",
    "Names of table files are absolute or relative to the working directory.",
)


def build(model: Model, destination: str | Path, *, page: str | None = None, reference: Mapping[str, bytes] | None = None) -> Path:
    """Write the FMU of `model` and return its path.

    `destination` is a file (`.fmu`) or a folder, where it is named after the model. `page` is the
    Markdown for its documentation (docs/components/<name>.md if not given), `reference` the reference
    experiment (as `fmus.reference.reference_files` gives it; the golden results if not given). Equal sources give equal bytes.
    ValueError if the model's sources cannot be bundled, FileNotFoundError if pythonfmu is incomplete.
    """
    target = Path(destination)
    if target.suffix != ".fmu":
        target /= f"{model.name}.fmu"
    interface = Interface(model)
    sources, init = _sources(model)
    binaries = _binaries()
    content: dict[str, bytes] = {**terminal_files(interface, arrays=False), **licences(), **_pythonfmu_licence()}
    content["model.png"] = content["terminalsAndIcons/icon.png"]
    content["documentation/index.html"] = index_html(interface, "Python backend", NOTES, page).encode()
    experiment, described = experiment_files(interface, False, reference_files(model.name) if reference is None else reference)
    content |= experiment
    content |= {f"resources/tables/{name}.npy": _npy(table.rows) for name, table in model.built_in.items()}
    options = Options(
        identifier=model.name,
        guid="",
        tool=f"robomill {release()} (pythonfmu {version('pythonfmu')})",
        version=release(),
        variable_step=probe.accepts_other_steps(interface),
        initial_dependencies=probe.initial_dependencies(interface),
    )
    digest = hashlib.sha256(model_description_2(interface, options))
    for name, data in sorted({**content, **sources, **binaries, "__init__": init.encode(), "script": SCRIPT.encode()}.items()):
        digest.update(f"{name}\0{len(data)}\0".encode() + data)
    package = f"robomill_{digest.hexdigest()[:16]}"

    guid = f"{{{UUID(digest.hexdigest()[:32])}}}"
    content["modelDescription.xml"] = model_description_2(interface, Options(**{**options.__dict__, "guid": guid}))
    content |= {f"binaries/{folder}/{model.name}{Path(library).suffix}": binaries[folder] for folder, library in PLATFORMS.items()}
    content["resources/slavemodule.txt"] = f"slave_{package}\n".encode()
    content[f"resources/slave_{package}.py"] = SCRIPT.replace("{package}", package).encode()
    home = f"resources/python/{package}"
    bundled = {name.partition("/")[0].removesuffix(".py") for name in sources}
    for name, data in {**sources, "__init__.py": init.replace("{package}", package).encode()}.items():
        content[f"{home}/{name}"] = _renamed(name, data, package, bundled) if name.endswith(".py") else data
    needed = (material("pythonfmu", "MIT", "required"), material("numpy", "BSD-3-Clause", "required"))
    materials = (*needed, material("numba", "BSD-2-Clause", "optional"))
    origin = Origin(model.name, "python", "2.0", tuple(PLATFORMS), materials, {**sources, "__init__.py": init.encode()})
    provenance, stated = provenance_files(origin, content)
    archive.write(target, {**content, **provenance, **manifest_files([*described, *stated])})
    return target


def _sources(model: Model) -> tuple[dict[str, bytes], str]:
    """Files of the package below its folder, imports not yet renamed, and its `__init__.py` with the package's name left open."""
    if isinstance(model, ReplayModel):
        module, imports = "robomill.models.components.recording", REPLAY_IMPORTS
    elif isinstance(model, CorrectionModel):
        module, imports = "robomill.models.components.correction", FORM_IMPORTS
    else:
        try:
            check_kernels(model.init, model.step)
            module, attribute = home(model)
        except ValueError as error:
            raise ValueError(f"model {model.name!r}: not bundled: {error}") from None
        imports = f"from {module} import {attribute}{'' if attribute == 'MODEL' else ' as MODEL'}"
    try:
        modules = source_files(module) | source_files(RUNTIME) | source_files(_INSTALLER) | source_files("robomill.user_cache")
    except ModuleNotFoundError as error:
        raise ValueError(f"model {model.name!r}: not bundled: {error}") from None
    files: dict[str, bytes] = {}
    for name, file in modules.items():
        inside = name.replace(".", "/") + ("/__init__.py" if file.name == "__init__.py" else ".py")
        files[inside] = file.read_bytes().replace(b"\r\n", b"\n")
    for inside in list(files):  # packages that are only passed through
        for folder in list(PurePosixPath(inside).parents)[:-1]:
            files.setdefault(f"{folder}/__init__.py", b"")
    files |= {
        f"robomill/models/data/{f.relative_to(DATA).as_posix()}": f.read_bytes().replace(b"\r\n", b"\n")
        for f in sorted(DATA.rglob("*.toml"))
    }
    if isinstance(model, ReplayModel):
        files["replay.json"] = json.dumps(model.specification, indent=1, sort_keys=True).encode()
        files["recording.npy"] = _npy(model.default_tables["recording"])
    if isinstance(model, CorrectionModel):
        files["law.form.json"] = json.dumps(model.specification, indent=1, sort_keys=True).encode()
    return files, PACKAGE_INIT.replace("{description}", model.description).replace("{imports}", imports)


def _renamed(name: str, source: bytes, package: str, bundled: set[str]) -> bytes:
    """The source with the imports of bundled packages put below `package`. ValueError for an import that cannot be."""
    lines = source.decode().split("\n")
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and not node.level and (node.module or "").partition(".")[0] in bundled:
            line = lines[node.lineno - 1]
            start = line[: node.col_offset] + "from "
            lines[node.lineno - 1] = start + f"{package}." + line[len(start) :]
        elif isinstance(node, ast.Import) and any(a.name.partition(".")[0] in bundled for a in node.names):
            raise ValueError(
                f"{name}, line {node.lineno}: not bundled: write `from package import module` instead of `import package.module`"
            )
    return "\n".join(lines).encode()


def _binaries() -> dict[str, bytes]:
    import pythonfmu

    folder = Path(pythonfmu.__file__).parent / "resources" / "binaries"
    return {platform_name: (folder / platform_name / library).read_bytes() for platform_name, library in PLATFORMS.items()}


def _pythonfmu_licence() -> dict[str, bytes]:
    for file in distribution("pythonfmu").files or ():
        if file.name.upper().startswith("LICENSE"):
            return {"documentation/licenses/pythonfmu.txt": file.read_binary()}
    return {}


def _npy(rows: FloatArray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.ascontiguousarray(rows, dtype="<f8"))
    return stream.getvalue()
