"""Where the gap between a simulation and its measured runs lies, what causes it, and how far it shrinks. Knows no robots."""
