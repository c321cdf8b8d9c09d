"""Whether the logs can be diagnosed: faults of recording, the set of runs, phases."""
