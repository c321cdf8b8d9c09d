"""Tests of what a component can be: an FMU here or in its own process, a recording, at any rate."""
