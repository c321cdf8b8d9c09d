"""Tests of measured and simulated runs."""
