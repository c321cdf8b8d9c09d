"""Tests of the benchmarks of masters."""
