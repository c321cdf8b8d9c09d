"""Tests of the benchmark of withheld effects."""
