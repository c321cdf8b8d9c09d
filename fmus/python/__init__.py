"""FMUs that run in the Python of the receiving machine (pythonfmu); see `builder`."""
