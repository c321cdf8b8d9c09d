"""Tests of FMUs that run in the Python of their importer."""
