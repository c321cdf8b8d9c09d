"""Tests of system files, parameters and wiring."""
