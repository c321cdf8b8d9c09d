"""Tests of recorded runs, and of runs that are cut off."""
