"""Keys of the tables that name robot, tool, material and sensor; `cell.equipment` looks them up."""

from __future__ import annotations

from robomill.orchestration.system import keys
from robomill.orchestration.system.keys import Keys, optional


class EquipmentKeys(Keys):
    """A piece of equipment, by the name of one that comes with robomill or by a file of your own; give one of the two."""

    name = optional(keys.text(), "name of a file in the folder of models/data for this piece, without its suffix")
    file = optional(keys.text(), "a file of the same form, relative to this one")


class RobotKeys(EquipmentKeys):
    """The robot of all components, by the name of one that comes with robomill or by a file of your own; give one of the two."""

    compliance = optional(
        keys.text(), "springs of its joints: a name of models/data/compliance or a .toml file (default: those of its name)"
    )
    dynamics = optional(keys.text(), "its rigid bodies: a name of models/data/dynamics or a .toml file (default: those of its name)")


class EquippedKeys(Keys):
    """Equipment that a file names for all components, in place of what the system names."""

    robot = optional(keys.table(RobotKeys), "the robot (models/data/robots)")
    tool = optional(keys.table(EquipmentKeys), "the end effector: where the tool tip is, mass (models/data/tools)")
    material = optional(keys.table(EquipmentKeys), "the material: cutting coefficients (models/data/materials)")
    sensor = optional(keys.table(EquipmentKeys), "the force sensor: range, resolution, noise (models/data/sensors)")
