"""Tests of the second generator of blind cases."""
