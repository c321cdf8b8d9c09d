"""Writes docs/reference from the program itself: commands, file formats, Python API, errors. `python -m reference` writes all pages."""
