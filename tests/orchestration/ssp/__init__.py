"""Tests of SSP packages."""
