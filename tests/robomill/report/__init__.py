"""Tests of the report of a diagnosis."""
