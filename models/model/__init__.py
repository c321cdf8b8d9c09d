"""What a model is: declared variables, units, parameter files, tables, compiled code."""
