"""Packages that are not installed with robomill itself."""

from __future__ import annotations

import importlib
from typing import Any

from robomill.orchestration.errors import MissingPackageError


def optional(package: str, what: str) -> Any:
    """A package that need not be installed. MissingPackageError says how it is installed; `what` needs it."""
    try:
        return importlib.import_module(package)
    except ImportError:
        raise MissingPackageError(
            f"{what} needs the package {package!r}, which is not installed; install it with: pip install robomill[{package}]"
        ) from None
