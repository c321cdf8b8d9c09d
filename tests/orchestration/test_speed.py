"""What the master itself costs per macro step."""

from __future__ import annotations

import time

import pytest

from orchestration.master import Master
from orchestration.slave import PortData
from orchestration.wiring import wire
from tests.orchestration.mocks import Mock, system

LIMIT = 25e-6
"""Seconds per macro step of six components with twelve inputs and outputs each."""


class Idle(Mock):
    """Does nothing, as fast as Python can."""

    def set_inputs(self, values):
        pass

    def step(self, t, h):
        pass

    def get_outputs(self, out):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
def test_cost_per_step(algorithm):
    ports = [PortData(f"{name}[{i}]", causality) for name, causality in (("u", "input"), ("y", "output")) for i in range(1, 13)]
    slaves = [Idle(name, ports, lambda u, t: [0.0] * 12) for name in "abcdef"]
    connections = [f"{a.name}.y {'=>' if b.name == 'a' else '->'} {b.name}.u" for a, b in zip(slaves, slaves[1:] + slaves[:1], strict=True)]
    s = system(slaves, *connections, algorithm=algorithm)
    master = Master({x.name: x for x in slaves}, wire(s, {x.name: x.ports for x in slaves}), s.step, algorithm)
    master.initialise(0.0, 1e6)

    def per_step(n: int = 2000) -> float:
        begin = time.perf_counter()
        for _ in range(n):
            master.step()
        return (time.perf_counter() - begin) / n

    assert min(per_step() for _ in range(5)) <= LIMIT
