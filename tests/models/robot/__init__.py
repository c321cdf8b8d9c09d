"""Tests of kinematics, virtual joints, dynamics."""
