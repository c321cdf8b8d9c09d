"""Tests of foreign logs."""
