"""FMUs without Python: a model lowered to machine code, with a small C face for FMI 2.0 and 3.0."""
