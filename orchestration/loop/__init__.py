"""The master: one communication step after the other, in Python and compiled."""
