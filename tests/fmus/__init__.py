"""Tests of what makes a model an FMU."""
