"""System description, wiring checks, the master, recording and results: any FMUs, no knowledge of any model."""
