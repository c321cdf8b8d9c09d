"""Tests of what a model is: declaration, parameters, units, tables, compile cache."""
