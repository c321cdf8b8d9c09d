"""Tests of the orchestration: slaves, system files, runs, the master, packages."""
