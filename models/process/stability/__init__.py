"""Stability of milling: modes of the structure, regenerative lobes, mode coupling, and what a coupling of two simulations adds to it."""
