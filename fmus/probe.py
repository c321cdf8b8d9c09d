"""What a model does, found out by trying it, where the declaration does not say it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robomill.fmus.instance import DEFAULT_STEP, ComponentError, Instance
from robomill.fmus.interface import Interface

TRIALS = 3


def accepts_other_steps(interface: Interface, plain: bool = False) -> bool:
    """Whether a model that takes a step of 4 ms also takes one of 3 ms; False if it takes neither."""
    instance = Instance(interface, plain=plain)
    try:
        instance.init()
        start = instance.state()
        for h in (DEFAULT_STEP, 0.75 * DEFAULT_STEP):
            instance.restore(start)
            instance.step(0.0, h)
    except ComponentError:
        return False
    return True


def initial_dependencies(interface: Interface, plain: bool = False) -> Mapping[str, tuple[str, ...]]:
    """Per output the names of the inputs that its initial value depends on.

    Those that it declares for a step and those found by changing inputs, one declared variable at a
    time, and looking at which outputs of `init` change. None found and none declared = ().
    """
    instance = Instance(interface, plain=plain)
    inputs = {
        name: interface.inputs[s] for name, s in interface.arrays.items() if interface.inputs[s] and interface.inputs[s][0].variable == name
    }
    found: dict[str, set[str]] = {p.name: set() for p in interface.outputs}
    try:
        instance.init()
    except ComponentError:
        return {p.name: tuple(i.name for i in interface.inputs) for p in interface.outputs}
    base = [instance.get(p) for p in interface.outputs]
    rng = np.random.default_rng(20)
    for ports in inputs.values():
        for _ in range(TRIALS):
            instance.reset()
            for port in ports:
                value = float(port.start)
                if port.type == "real":
                    instance.floats[port.reference] = value + (abs(value) if value else 1.0) * rng.uniform(-0.02, 0.02)
                else:
                    instance.integers[port.reference] = 1 - int(value) if port.type == "boolean" else int(value) + 1
            try:
                instance.init()
            except ComponentError:
                continue
            for port, before in zip(interface.outputs, base, strict=True):
                if instance.get(port) != before:
                    found[port.name].update(p.name for p in ports)
    order = [p.name for p in interface.inputs]
    result: dict[str, tuple[str, ...]] = {}
    for port in interface.outputs:
        names = found[port.name] | set(order if port.dependencies is None else port.dependencies)
        result[port.name] = tuple(n for n in order if n in names)
    return result
