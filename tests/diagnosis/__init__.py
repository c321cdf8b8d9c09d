"""Tests of the diagnosis on small systems that are known; the cell is in tests/cell and tests/robomill."""
