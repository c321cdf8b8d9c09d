"""What components of a milling cell cannot do together, though each is right by itself: said before anything runs.

A force that has no direction cannot compensate a deflection, which has one; a controlled feed needs a path that follows it.
"""

from __future__ import annotations

from typing import Any

from robomill.cell.equipment import ports_of
from robomill.fmus.components import is_component
from robomill.orchestration.errors import SystemFileError
from robomill.orchestration.slaves.protocol import arrays
from robomill.orchestration.system.definition import System

__all__ = ["check_combination"]

_FORCE = "f_T_T"
"""Input that is a measured force vector (docs/nomenclature.md)."""


def check_combination(system: System) -> None:
    """SystemFileError with the reason and the remedy where a compensation has no force vector, or a rate control no feed to control.

    Components from outside are taken as they are: their ports are checked with the wiring.
    """
    taken = {c.target.partition("[")[0] for c in system.connections}
    _check_source_of_force(system)
    for component in system.components:
        if component.source in ("compensation_controller", "deformation_compensation"):
            _check_compensation(system, component.name, taken)
        elif component.source == "rate_controller" and any(c.name == "path" for c in system.components):
            _check_rate(system, component.name, taken)


def _check_source_of_force(system: System) -> None:
    for c in system.connections:
        target, _, port = c.target.partition(".")
        source, _, signal = c.source.partition(".")
        if port != _FORCE or source not in {x.name for x in system.components}:
            continue
        component = system.component(source)
        if not is_component(component.source):
            continue
        outputs = arrays([p for p in ports_of(system, source) if p.causality == "output"])
        if signal not in outputs:
            raise SystemFileError(
                f"{system.where(component.line)}component {source!r} ({component.source}) cannot feed {target!r}: it gives "
                f"{', '.join(outputs)}, and no force vector {signal}. A deflection has a direction, so its compensation needs sensor_chain "
                f"or spindle_holder there; use one of these, or let {component.source} lead a rate_controller"
            )


def _check_compensation(system: System, name: str, taken: set[str]) -> None:
    mode, pilot = _value(system, name, "mode"), bool(_value(system, name, "pilot"))
    if not mode:
        return
    where = system.where(system.component(name).line)
    if not pilot and f"{name}.{_FORCE}" not in taken:
        raise SystemFileError(
            f"{where}component {name!r} compensates (mode = {mode:g}), but nothing is connected to {name}.{_FORCE}: connect the force of "
            "a sensor_chain or a spindle_holder, or set mode = 0"
        )
    if pilot and f"{name}.f_pilot_B" not in taken:
        raise SystemFileError(
            f"{where}component {name!r} has pilot = true, but nothing is connected to {name}.f_pilot_B: connect path.f_pilot_B, "
            "or set pilot = false"
        )


def _check_rate(system: System, name: str, taken: set[str]) -> None:
    variant = _value(system, name, "variant")
    missing = [port for port in (f"{name}.force", f"{name}.feed", "path.speed_ratio") if port not in taken]
    if variant and missing:
        raise SystemFileError(
            f"{system.where(system.component(name).line)}component {name!r} controls the feed (variant = {variant:g}), but nothing is "
            f"connected to {', '.join(missing)}: rate control needs a force, and a speed_loop between {name}.speed_ratio and "
            f"path.speed_ratio that gives {name}.feed back; or set variant = 0"
        )


def _value(system: System, name: str, parameter: str) -> Any:
    """The value of a switch, as given or as it starts; 0 if there is none."""
    given = system.component(name).parameters.get(parameter)
    if given is not None:
        return given if isinstance(given, int | float) else 0  # what is no number is refused with the parameters
    return next((p.start for p in ports_of(system, name) if p.name == parameter), 0)
