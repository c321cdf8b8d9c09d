"""Measuring the machined part: nominal and actual surface from the paths of the cutter."""
