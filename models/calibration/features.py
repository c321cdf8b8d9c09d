"""How long the polynomial of the hose pack is, for what identifies it and for what simulates it."""

FEATURES = 15
"""Number of coefficients of Eq. (17) of Haehn & Weigold 2020 per force component."""
