"""Robot programs in the languages of controllers: KUKA KRL, ABB RAPID and G-code, from one internal form (docs/how_to/planning.md).

`poses` holds the internal form, a sequence of poses in the workpiece frame; `krl`, `rapid` and `gcode_text` write it; `krl` and
`rapid` read back what they wrote; `convert` makes it of a program that was read and of it a path that is planned.
"""

from robomill.models.planning.languages.gcode_text import write_gcode
from robomill.models.planning.languages.krl import read_krl, write_krl
from robomill.models.planning.languages.poses import Frames, LanguageError, PoseProgram, pose_program
from robomill.models.planning.languages.rapid import read_rapid, write_rapid

__all__ = [
    "Frames",
    "LanguageError",
    "PoseProgram",
    "pose_program",
    "read_krl",
    "read_rapid",
    "write_gcode",
    "write_krl",
    "write_rapid",
]
