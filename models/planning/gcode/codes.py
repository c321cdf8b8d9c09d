"""G and M codes: modal groups, what has no effect on a robot's path, and what is refused, in words.

Meaning of the codes: NIST RS274/NGC Interpreter version 3 (NISTIR 6556, 2000), LinuxCNC for what came later, and the
Fanuc codes that CAM systems write.
"""

from __future__ import annotations

from collections.abc import Mapping

GROUPS: Mapping[str, tuple[float, ...]] = {
    "motion": (0, 1, 2, 3, 73, 81, 82, 83, 84, 85, 86, 88, 89),
    "plane": (17, 18, 19),
    "units": (20, 21, 70, 71),
    "cutter compensation": (40, 41, 42),
    "tool length": (43, 49),
    "work offset": (54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3),
    "path control": (61, 61.1, 64),
    "distance": (90, 91),
    "arc centre": (90.1, 91.1),
    "feed mode": (93, 94, 95),
    "retract": (98, 99),
    "action": (4, 10, 28, 28.1, 30, 30.1, 52, 92, 92.1, 92.2, 92.3),
    "machine": (53,),
    "exact": (9,),
    "cancel": (80,),
}
"""Modal groups: one code of a group per block. Not modal: action, machine, exact."""
GROUP_OF = {code: group for group, codes in GROUPS.items() for code in codes}
CYCLES = (73, 81, 82, 83, 84, 85, 86, 88, 89)
PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
"""First, second and normal axis of the plane of arcs and cycles; right-handed in this order."""

_LOOK_AHEAD = "look-ahead of the control"
_OFF = "switches off what is never on here"
_LENGTH = "tool length: the tool frame of the robot controller holds it"
SKIPPED_G: Mapping[float, str] = {
    5.1: _LOOK_AHEAD,
    8: _LOOK_AHEAD,
    13.1: _OFF,
    15: _OFF,
    22: "stroke limits",
    23: "stroke limits",
    25: "spindle monitoring",
    26: "spindle monitoring",
    40.1: _OFF,
    43.1: _LENGTH,
    50: _OFF,
    50.1: _OFF,
    67: _OFF,
    69: _OFF,
    97: "spindle speed in rev/min, as always here",
    113: _OFF,
    187: _LOOK_AHEAD,
}
"""G codes that change nothing here; their words go with them."""
REFUSED_G: Mapping[float, str] = {
    5: "splines",
    5.2: "splines",
    5.3: "splines",
    6.2: "splines",
    7: "diameter programming of lathes",
    7.1: "cylindrical interpolation",
    11: "circular data input",
    12: "a circular pocket cycle",
    13: "a circular pocket cycle",
    12.1: "polar interpolation",
    16: "polar coordinates",
    31: "probing: where the path ends depends on what the probe finds",
    38.2: "probing: where the path ends depends on what the probe finds",
    38.3: "probing: where the path ends depends on what the probe finds",
    38.4: "probing: where the path ends depends on what the probe finds",
    38.5: "probing: where the path ends depends on what the probe finds",
    32: "threads",
    33: "threads",
    33.1: "threads",
    41.1: "cutter radius compensation",
    42.1: "cutter radius compensation",
    43.4: "five axes",
    43.5: "five axes",
    44: "negative tool length",
    51: "scaling",
    51.1: "mirroring",
    54.1: "more work offsets than G54 .. G59.3",
    65: "macros",
    66: "macros",
    68: "rotated coordinates",
    68.2: "a tilted plane",
    72: "lathe cycles",
    74: "left-hand tapping",
    76: "fine boring or threads",
    87: "back boring",
    92.4: "tool frames",
    96: "constant surface speed",
}
"""G codes that change the path in a way that is not built, in words."""

STOPS = {
    0: "program stop: the robot stops and goes on",
    1: "optional stop: the robot stops and goes on",
    60: "pallet change: the robot stops",
}
"""M codes at which the path comes to rest."""
SPINDLE = {3: 1, 4: -1, 5: 0}
ENDS = (2, 30, 99)
TOOL_CHANGE = 6
SKIPPED_M: Mapping[float, str] = {
    7: "coolant",
    8: "coolant",
    9: "coolant",
    19: "spindle orientation",
    48: "overrides",
    49: "overrides",
    50: "overrides",
    51: "overrides",
    52: "overrides",
    53: "overrides",
}
REFUSED_M: Mapping[float, str] = {
    96: "subroutines",
    97: "subroutines",
    98: "subroutines",
    198: "subroutines",
}
OTHER_M = "not known here: a switch of the machine"
SUPPORTED_G = " ".join(f"G{code:g}" for code in sorted(GROUP_OF))
