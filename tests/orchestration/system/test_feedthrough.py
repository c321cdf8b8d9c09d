"""The order of execution on systems made by chance."""

from __future__ import annotations

import random

import pytest

from robomill.orchestration.system.feedthrough import execution_order


def by_definition(through, links, components):
    """In each place the component with the fewest connections from those that still wait: those that matter, then the others."""
    connected = {source for source, _ in links}
    edges = set(), set()
    for source, target in links:
        if source[0] != target[0]:
            edges[not any(o in connected for o in through.get(target, ()))].add((source[0], target[0]))
    remaining, order = list(components), []
    while remaining:
        order.append(min(remaining, key=lambda name: [sum(b == name and a in remaining for a, b in kind) for kind in edges]))
        remaining.remove(order[-1])
    return order


@pytest.mark.parametrize("seed", range(200))
def test_the_order_is_that_of_its_definition(seed):
    chance = random.Random(seed)
    components = [f"c{i}" for i in range(chance.randint(1, 9))]
    links = [
        ((chance.choice(components), f"y{chance.randint(0, 1)}"), (chance.choice(components), f"u{chance.randint(0, 1)}"))
        for _ in range(chance.randint(0, 20))
    ]
    through = {(c, f"u{i}"): [(c, f"y{j}") for j in (0, 1) if chance.random() < 0.4] for c in components for i in (0, 1)}
    assert execution_order(through, links, components) == by_definition(through, links, components)
