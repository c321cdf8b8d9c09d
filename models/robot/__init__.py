"""The robot: kinematics, virtual joints, rigid-body dynamics."""
