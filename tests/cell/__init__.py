"""Tests of the milling cell: scenarios, runs, what they come to, and the same numbers whatever the components are made of."""
