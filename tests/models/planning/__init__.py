"""Tests of the way from a part program to a trajectory."""
