"""First thing that runs in a Python FMU: imports the package it carries, from a folder where compiled code can stay.

An importer unpacks an FMU to a new temporary folder each time, where Numba would find nothing of
what it compiled before. So the package is copied once to the cache folder of the user, under its
name, which holds a hash of its content. Only the standard library is used here.
"""

import atexit
import ctypes
import filecmp
import importlib.util
import os
import shutil
import sys
import threading
import uuid
from contextlib import suppress
from pathlib import Path
from types import ModuleType


def install(package: str, bundle: str) -> ModuleType:
    """Import the package that stands in the folder `bundle`, from its copy in the cache folder if that is possible."""
    source = Path(bundle)
    cache = _module("user_cache", source / "robomill" / "user_cache.py")
    folder, notes = source, []
    try:
        folder = _copy(source, cache.user_folder() / "fmu" / package)
        cache.prune(folder.parent, package)
    except OSError as error:
        notes.append(f"the cache folder cannot be used ({error}): the model is compiled anew in every process")
    module = _module(package, folder / "__init__.py", register=True)
    module.ComponentSlave.notes = tuple(notes)
    if sys.platform == "linux":
        binaries = source.parents[2] / "binaries" / "linux64"
        atexit.register(_release, [file.name for file in binaries.glob("*.so")])
    return module


def _release(names: list[str]) -> None:
    """Have pythonfmu's library drop its hold on the interpreter while the process is still whole.

    A library that was not unloaded (0.7) drops it twice when the process ends: once as its variables are destroyed and
    again in its own destructor, which then writes into memory that has been given back ("corrupted double-linked list").
    Where the library has started the interpreter itself, the thread that runs this is the one it would wait for.
    """
    if threading.get_native_id() != os.getpid():
        return
    maps = Path("/proc/self/maps").read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    mapped = {line.split(maxsplit=5)[5].removesuffix(" (deleted)") for line in maps if ".so" in line}
    for file in sorted(mapped):
        if Path(file).name in names and Path(file).parent.name == "linux64":
            with suppress(OSError, AttributeError):  # unloaded meanwhile; another library of that name
                ctypes.CDLL(file, mode=os.RTLD_NOLOAD | os.RTLD_LAZY).finalizePythonInterpreter()


def _copy(source: Path, target: Path) -> Path:
    """`target`, holding the same files as `source`. OSError if it cannot be written or holds others."""
    if not target.is_dir():
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f".{target.name}.{uuid.uuid4().hex}")
        try:
            shutil.copytree(source, partial, ignore=shutil.ignore_patterns("__pycache__"))
            with suppress(OSError):  # another process was faster
                partial.rename(target)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    files = [str(f.relative_to(source)) for f in source.rglob("*") if f.is_file() and "__pycache__" not in f.parts]
    _, differing, missing = filecmp.cmpfiles(source, target, files, shallow=False)
    if differing or missing:
        raise OSError(f"{target} holds other files than this FMU: {', '.join([*differing, *missing][:3])}")
    os.utime(target)
    return target


def _module(name: str, file: Path, register: bool = False) -> ModuleType:
    """Import a file under a name; `register` makes it known to others, as a package if it is one."""
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot load {file}")
    module = importlib.util.module_from_spec(spec)
    if register:
        sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        sys.modules.pop(name, None)
        raise
    return module
