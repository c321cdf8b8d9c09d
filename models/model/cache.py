"""Where compiled code is kept: folders per user, named after the sources that the code was made from.

Numba's own disk cache notices an edit in the file of the compiled function, not one in a function
or a constant that it uses from another file. Here the name of the folder is a hash of every file
that the model is made from (`source_files`) and of the parameter files, so any edit makes a new folder.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
import os
import sys
import sysconfig
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from robomill.machine_code import numba_version
from robomill.user_cache import prune, use, user_folder

PACKAGE = Path(__file__).parents[1]
# builds side by side: CPython 3.11 counts the depth of its trees for all threads together, and then finds it wrong
_PARSING = threading.Lock()


@contextmanager
def compiled_code(*functions: Callable[..., Any]) -> Iterator[None]:
    """While active, functions that get `njit(cache=True)` are kept in the folder of their sources.

    Inside an FMU nothing is done: its package stands in a folder of its own, named after its
    content, and Numba keeps the code beside it.
    """
    if __name__ != "robomill.models.model.cache":
        yield
        return
    import numba

    config: Any = numba.config
    before = config.CACHE_DIR
    folder = _folder(functions)
    with suppress(OSError):  # a home that cannot be written to: Numba's own place, at worst a compilation per process
        if not folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            prune(folder.parent, folder.name)
        os.utime(folder)
        config.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        config.CACHE_DIR = before


def compiled_before(*functions: Callable[..., Any]) -> bool:
    """Whether `compiled_code` has been active for these sources before, in any process; False inside an FMU."""
    return __name__ == "robomill.models.model.cache" and _folder(functions).is_dir()


def kept_code(name: str, *functions: Callable[..., Any]) -> Path | None:
    """File (its name is to be completed) for the machine code of functions; None if it cannot be told what they are made from.

    Inside an FMU it stands in the package's own folder, which is named after its content.
    """
    if not all(Path(f.__code__.co_filename).is_file() for f in functions):
        return None
    if __name__ != "robomill.models.model.cache":
        return Path(__file__).parent / "__pycache__" / name
    folder = _folder(functions)
    use(folder)
    return folder / name


def _folder(functions: tuple[Callable[..., Any], ...]) -> Path:
    return user_folder() / "numba" / _key(functions, numba_version())


def source_files(module: str) -> dict[str, Path]:
    """Module name -> source file of `module` and of all that it imports, also inside functions and through others.

    Followed are `robomill`, the top-level package of `module` itself and everything that is not installed as a
    library. A package that is only passed through on the way to a module is not among them.
    ModuleNotFoundError if one of them does not exist.
    """
    own = {"robomill", module.partition(".")[0]}
    found: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        file = _file(name)
        if file is None:
            raise ModuleNotFoundError(f"no source file of module {name!r}, which {module!r} imports")
        found[name] = file
        package = name if file.name == "__init__.py" else name.rpartition(".")[0]
        for imported, names in _imports(file, _stamp(file)):
            if names is None:
                waiting += [imported] if _followed(imported, own) else []
                continue
            source = importlib.util.resolve_name(imported, package)
            if _followed(source, own):
                modules = [n for alias in names if _file(n := f"{source}.{alias}")]
                waiting += modules if len(modules) == len(names) else [source, *modules]
    return dict(sorted(found.items()))


@cache
def _imports(file: Path, _: tuple[int, int]) -> list[tuple[str, list[str] | None]]:
    """What a source file of that stamp imports, in its order: (module, None), or (module, names) where names are taken from it."""
    with _PARSING:
        tree = ast.parse(file.read_text(encoding="utf-8"))
    found: list[tuple[str, list[str] | None]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found.append(("." * node.level + (node.module or ""), [alias.name for alias in node.names]))
    return found


def _stamp(file: Path | str) -> tuple[int, int]:
    """Time of the last change [ns] and size of a file: what Numba, too, knows a changed source by."""
    status = Path(file).stat()
    return status.st_mtime_ns, status.st_size


def _followed(module: str, own: set[str]) -> bool:
    """Whether a module is one of `own`, or a source file that is not part of Python or of an installed library."""
    top = module.partition(".")[0]
    if top in own:
        return True
    file = None if top in sys.stdlib_module_names else _file(top)
    return file is not None and not any(Path(sysconfig.get_path(kind)) in file.parents for kind in ("purelib", "platlib", "stdlib"))


def _file(module: str) -> Path | None:
    """Source file of a module, None if there is no such module or it has none (built in, extension, namespace)."""
    loaded = getattr(sys.modules.get(module), "__file__", None)  # another file may be loaded under the name of one before
    return Path(loaded) if loaded is not None and loaded.endswith(".py") else _found(module)


@cache
def _found(module: str) -> Path | None:
    """Source file of a module that need not be loaded; see `_file`."""
    with suppress(ImportError, AttributeError, ValueError):
        spec = importlib.util.find_spec(module)
        if spec is not None and spec.origin is not None and spec.origin.endswith(".py"):
            return Path(spec.origin)
    return None


def _key(functions: tuple[Callable[..., Any], ...], numba_version: str) -> str:
    """Hash of the sources of `functions`, of the parameter files and of the compiler's version.

    Hash and files are kept on disk with the stamps of the files: to follow all imports takes a second, to look at the stamps a
    millisecond.
    """
    compiler = f"{numba_version} {sys.version}"
    origins = [(f.__module__, f.__code__.co_filename) for f in functions]
    asked = hashlib.sha256(repr((compiler, origins, sys.path, str(Path.cwd()))).encode()).hexdigest()[:20]
    kept = user_folder() / "sources" / asked / "stamps.json"
    with suppress(OSError, ValueError, KeyError, TypeError):
        known = json.loads(kept.read_text(encoding="utf-8"))
        if known["stamps"] == {**_data_stamps(), **_stamps(known["stamps"].keys() - _data_stamps().keys())}:
            os.utime(kept.parent)
            return str(known["key"])
    files = {*_data_stamps(), *(f for _, f in origins)}
    for function in functions:
        with suppress(ModuleNotFoundError):  # __main__, an interactive session
            files |= {str(f) for f in source_files(function.__module__).values()}
    files = {f for f in files if Path(f).is_file()}
    stamps = {**_stamps(files), **_data_stamps()}  # before they are read: who edits one meanwhile is noticed the next time
    digest = hashlib.sha256(compiler.encode())
    for file in sorted(files):
        digest.update(f"{file}\0".encode())
        digest.update(hashlib.sha256(Path(file).read_bytes()).digest())
    key = digest.hexdigest()[:20]
    with suppress(OSError):
        kept.parent.mkdir(parents=True, exist_ok=True)
        partial = kept.with_name(f"{kept.name}.{os.getpid()}")
        partial.write_text(json.dumps({"key": key, "stamps": stamps}), encoding="utf-8")
        partial.replace(kept)
        prune(kept.parent.parent, asked)
    return key


def _stamps(files: Iterable[str]) -> dict[str, list[int]]:
    return {file: list(_stamp(file)) for file in files}


@cache
def _data_stamps() -> dict[str, list[int]]:
    """The parameter files. What comes later, or changes, is not what a model of this process was made from."""
    return _stamps(f"{folder}{os.sep}{n}" for folder, _, names in os.walk(PACKAGE / "data") for n in names if n.endswith(".toml"))
