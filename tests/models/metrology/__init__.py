"""Tests of the scanner of milled surfaces."""
