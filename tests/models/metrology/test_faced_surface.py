"""The surface that a face cutter leaves, against the plane that was programmed."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.models.metrology.faced_surface import WAY, beside_openings, faced_surface
from robomill.models.metrology.tool_path import ToolPath
from robomill.models.model.declaration import FloatArray
from tests.tolerances import EXACT, ROUNDOFF, physics

RADIUS, PLANE, SIZE = 0.03, -3e-3, (0.1, 0.04)
SPACING = 2e-3


def straight(depth: float, tilt: tuple[float, float] = (0.0, 0.0), wave: float = 0.0) -> ToolPath:
    x = np.arange(-0.09, 0.09, 1e-4)
    z = -depth + wave * np.sin(2.0 * np.pi * x / 0.2)
    position = np.column_stack([x, np.zeros_like(x), z])
    return ToolPath(x, position, np.tile(np.array(tilt), (len(x), 1)), np.full(len(x), RADIUS))


def test_a_cutter_on_the_plane_leaves_no_error():
    found = faced_surface(straight(3e-3), SIZE, PLANE, SPACING)
    assert np.all(found.error == EXACT)
    assert (found.mean, found.touch, found.clean, found.total) == (EXACT, EXACT, EXACT, EXACT)


def test_a_deeper_cutter_leaves_its_overcut():
    found = faced_surface(straight(3.4e-3), SIZE, PLANE, SPACING)
    assert found.mean == pytest.approx(4e-4, rel=1e3 * ROUNDOFF)


def test_a_cutter_tilted_across_the_feed_leaves_a_slope():
    slope = 1e-3
    found = faced_surface(straight(3e-3, (0.0, slope)), SIZE, PLANE, SPACING)
    expected = slope * found.y / np.sqrt(1.0 - slope**2)
    assert found.error == pytest.approx(np.tile(expected[:, None], (1, len(found.x))), rel=1e6 * ROUNDOFF, abs=1e3 * ROUNDOFF)


@pytest.mark.parametrize("slope", [1e-3, -1e-3])
def test_a_cutter_tilted_along_the_feed_cuts_with_one_edge(slope: float):
    """Fore or aft, its lowest edge leaves sqrt(R^2 - y^2) times the slope, whichever of the two it is."""
    found = faced_surface(straight(3e-3, (slope, 0.0)), SIZE, PLANE, SPACING)
    edge = abs(slope) * np.sqrt(RADIUS**2 - found.y**2)
    # imprints stand WAY apart: the edge is up to WAY away from a point
    assert np.abs(found.error - edge[:, None]).max() < physics(0.0, absolute=2.0 * abs(slope) * WAY)


def test_the_surface_of_waves_is_that_of_their_troughs():
    """Envelope: at every point the lowest that the disc over it has been, R sin(...) ahead and behind."""
    wave = 2e-4
    found = faced_surface(straight(3e-3, wave=wave), SIZE, PLANE, SPACING)
    reach = np.linspace(-RADIUS, RADIUS, 2001)
    lowest = np.array([np.max(-wave * np.sin(2.0 * np.pi * (x + reach) / 0.2)) for x in found.x])
    # the slope of the wave over the way between two imprints
    assert np.abs(found.along(0.0) - lowest).max() < physics(0.0, absolute=wave * 2.0 * np.pi / 0.2 * WAY)


def test_where_the_cutter_has_not_been_there_is_nothing():
    found = faced_surface(straight(3e-3), (0.1, 0.1), PLANE, SPACING)
    assert np.all(np.isnan(found.error[np.abs(found.y) > RADIUS + SPACING]))
    assert found.mean == EXACT


def test_openings_are_left_out():
    x, y = np.linspace(-0.05, 0.05, 101), np.linspace(-0.02, 0.02, 41)
    material: FloatArray = beside_openings(x, y, 0.02, (0.05, 0.08))
    # two whole openings of the row at y = +-40 mm lie beside the block: none; with a pitch of 40 mm their centres are on y = +-20 mm
    assert np.all(material == 1.0)
    half = beside_openings(x, y, 0.02, (0.05, 0.04))
    assert float(np.mean(half == 0.0)) == pytest.approx(4 * 0.5 * np.pi * 0.01**2 / (0.1 * 0.04), abs=physics(1.0, absolute=0.02))
    found = faced_surface(straight(3.4e-3), (0.1, 0.04), PLANE, 1e-3).where(half)
    assert np.count_nonzero(np.isnan(found.error)) == np.count_nonzero(half == 0.0)


def test_a_cutter_that_never_comes_near_the_plane_is_an_error():
    with pytest.raises(ValueError, match=r"never comes near the plane z = -0\.003 m within 0\.1 x 0\.04 m; check the depth"):
        faced_surface(straight(-1e-2), SIZE, PLANE, SPACING)
