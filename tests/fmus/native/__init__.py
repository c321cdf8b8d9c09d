"""Tests of FMUs without Python."""
