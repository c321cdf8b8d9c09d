"""Tests of identification from measurements."""
