"""Systems as SSP packages, written and read."""
