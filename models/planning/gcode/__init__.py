"""Read a G-code program (RS-274) as CAM systems write it: text in, moves in SI out (docs/how_to/gcode.md).

Three linear axes: lines, arcs and helices, cycles. What has no effect on the path is skipped and noted; what would change the path
and is not built, or is malformed, is refused with one `GCodeError` that says where, what was found and what is supported.
`words` reads lines, `codes` knows the codes, `state` is what a control remembers, `motion`, `arcs` and `cycles` make moves,
`reader` carries blocks out.
"""

from robomill.models.planning.gcode.actions import Arc, Dwell, GCodeError, Move, Program, Vector
from robomill.models.planning.gcode.reader import parse, read
from robomill.models.planning.gcode.state import DIALECTS, HOME, Dialect, Setup

__all__ = ["DIALECTS", "HOME", "Arc", "Dialect", "Dwell", "GCodeError", "Move", "Program", "Setup", "Vector", "parse", "read"]
