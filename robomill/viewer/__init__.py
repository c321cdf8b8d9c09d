"""Runs in space and time: one HTML file with robot, part, deviation and force, that opens offline (three.js is in it)."""

from __future__ import annotations

from robomill.viewer.page import View, view

__all__ = ["View", "view"]
