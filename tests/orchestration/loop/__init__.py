"""Tests of the master's loop, in Python and compiled."""
