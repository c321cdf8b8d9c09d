"""Components by name: those of this project, those that installed packages offer, and any model of an importable module or a file.

A package offers components by entry points of the group `robomill.components`::

    [project.entry-points."robomill.components"]
    kalman_sensor = "kalman_sensor.model:MODEL"

What nobody offers is named by where it stands: ``python:package.module:MODEL`` or ``python:folder/file.py:MODEL``.
Modules are imported when a component is asked for.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from robomill import installed
from robomill.models.model.declaration import Model

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "robomill.components"
PYTHON = "python:"
"""Begins a source that says where a model stands."""
PACKAGE = "robomill.models.components"
NAMES = (
    "path_interpolator",
    "robot_drive",
    "robot_compliance",
    "robot_compliance_dynamic",
    "milling_force",
    "sensor_chain",
    "compensation_controller",
    "inverse_dynamics",
    "speed_loop",
    "power_law_force",
    "rate_controller",
    "deformation_compensation",
    "face_milling_force",
    "tridexel_milling_force",
    "spindle_current",
    "surface_contact",
    "path_learning",
    "lead_through",
    "regenerative_milling",
    "spindle_holder",
)
"""In the order of the signal flow, then what stands beside it; each is `MODEL` in `models/components/<name>.py`."""


class _Components(Mapping[str, Model]):
    """Component name -> its model; ValueError for one that is offered, but cannot be used."""

    def __getitem__(self, name: str) -> Model:
        offered = [e for e in _offered() if e.name == name]
        shipped = _is_shipped(name)
        if not shipped and not offered:
            raise KeyError(f"unknown component {name!r}; available: {', '.join(self)}")
        if len(offered) + shipped > 1:
            takers = [_package(e) for e in offered] + ["robomill"] * shipped
            raise ValueError(f"component {name!r} is offered by {' and by '.join(takers)}; rename one, or uninstall one of the packages")
        if shipped:
            model: Model = import_module(f"{PACKAGE}.{name}").MODEL
            return model
        (entry,) = offered
        model = _imported(f"component {name!r}, offered by {_package(entry)}", entry.module, entry.attr)
        if model.name != name:
            raise ValueError(f"component {name!r}, offered by {_package(entry)}: the model is called {model.name!r}; give both one name")
        return model

    def __iter__(self) -> Iterator[str]:
        yield from filter(_is_shipped, NAMES)
        yield from sorted({e.name for e in _offered()} - set(NAMES))

    def __contains__(self, name: object) -> bool:
        return any(e.name == name for e in _offered()) or _is_shipped(name)

    def __len__(self) -> int:
        return sum(1 for _ in self)


@cache
def _is_shipped(name: object) -> bool:
    """Whether it is a component of this project: an FMU has some of them only."""
    return name in NAMES and find_spec(f"{PACKAGE}.{name}") is not None


@cache
def _offered() -> tuple[EntryPoint, ...]:
    """What installed packages offer; looked up once, as it takes milliseconds."""
    if not installed.may_offer(GROUP):
        return ()
    from importlib.metadata import entry_points

    return tuple(entry_points(group=GROUP))


COMPONENTS: Mapping[str, Model] = _Components()


def component(source: str) -> Model:
    """The model of a component: by its name, `package.module:MODEL` or `file.py:MODEL`, with or without ``python:`` before it.

    ValueError says what is wrong with it, or which components there are. Recordings: see `models.components.recording`.
    """
    if ":" not in source:
        try:
            return COMPONENTS[source]
        except KeyError as error:
            raise ValueError(error.args[0]) from None
    module, _, attribute = source.removeprefix(PYTHON).rpartition(":")
    if not module or not attribute.isidentifier():
        raise ValueError(f"component {source!r}: expected {PYTHON}package.module:MODEL or {PYTHON}file.py:MODEL")
    what = f"component {source!r}"
    return _imported(what, _importable(what, Path(module)) if module.endswith(".py") else module, attribute)


def beside(source: str, folder: Path) -> str:
    """A source whose file, if it names one, is taken from `folder`."""
    place, _, attribute = source.removeprefix(PYTHON).rpartition(":")
    return f"{PYTHON}{(folder / place).resolve()}:{attribute}" if source.startswith(PYTHON) and place.endswith(".py") else source


def home(model: Model) -> tuple[str, str]:
    """Module and attribute that hold a model; ValueError if none of the imported modules of its package does."""
    own = model.step.__module__
    top = own.partition(".")[0]
    for name in (own, *sorted(n for n in sys.modules if n.partition(".")[0] == top)):
        for attribute, value in vars(sys.modules[name]).items() if name in sys.modules else ():
            if value is model:
                return name, attribute
    raise ValueError(f"its step stands in module {own!r}, and no module of the package {top!r} holds the model under a name")


def companion(model: Model, name: str) -> Path:
    """A file that a package may ship beside the module of its model: its page (`<model>.md`), its effects (`catalogue.toml`)."""
    return Path(sys.modules[home(model)[0]].__file__ or "").with_name(name)


def is_component(source: str) -> bool:
    """Whether the source of a component of a system is one that runs in process, and that an FMU can be built of."""
    return source.startswith(PYTHON) or source in COMPONENTS


def _imported(what: str, module: str, attribute: str) -> Model:
    try:
        model = getattr(import_module(module), attribute)
    except ModuleNotFoundError as error:
        raise ValueError(
            f"{what}: {error}; install the package that has it, or name its file: {PYTHON}folder/file.py:{attribute}"
        ) from error
    except AttributeError:
        models = [k for k, v in vars(import_module(module)).items() if isinstance(v, Model)]
        raise ValueError(f"{what}: module {module} has no {attribute!r}; models in it: {', '.join(models) or 'none'}") from None
    except Exception as error:
        raise ValueError(f"{what}: {type(error).__name__} while {module} is imported: {error}") from error
    if not isinstance(model, Model):
        raise ValueError(f"{what}: {attribute} is a {type(model).__name__}; expected a robomill.models.model.declaration.Model")
    return model


def _importable(what: str, file: Path) -> str:
    """Module name of a file; the folder of its outermost package comes last on the search path."""
    if not file.is_file():
        beside = ", ".join(sorted(f.name for f in file.parent.glob("*.py"))) or "none"
        raise ValueError(f"{what}: no file {file}; Python files in that folder: {beside}")
    root, names = file.resolve().parent, [file.stem]
    while (root / "__init__.py").is_file():
        names.insert(0, root.name)
        root = root.parent
    name = ".".join(names)
    if str(root) not in sys.path:
        sys.path.append(str(root))
    spec = find_spec(name)
    if spec is None or spec.origin is None or Path(spec.origin).resolve() != file.resolve():
        taken = spec.origin if spec is not None else "a folder on the search path"
        raise ValueError(f"{what}: the module name {name!r} is taken by {taken}; rename the file")
    return name


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else entry.value
