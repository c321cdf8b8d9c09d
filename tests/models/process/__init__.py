"""Tests of chip, force and workpiece."""
