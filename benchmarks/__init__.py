"""Measurements of speed; `python -m benchmarks` writes docs/benchmarks."""
