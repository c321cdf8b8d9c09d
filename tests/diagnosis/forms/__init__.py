"""Tests of noise, estimation, search and evidence."""
