"""Tests of what makes pages of the docs."""
