"""Measurements of speed; `python -m benchmarks.masters` writes docs/benchmarks/masters.md."""
