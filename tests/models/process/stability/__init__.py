"""Tests of lobes, mode coupling and the exchange between two simulations."""
