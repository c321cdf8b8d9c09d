"""Where components come from: the slave protocol, FMUs of FMI 2.0 and 3.0, other processes, recordings."""
