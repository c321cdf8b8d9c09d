"""Tests of the orchestration: system files, wiring, master, FMUs, results."""
