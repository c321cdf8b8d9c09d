"""Colours of the pictures: eight that are told apart with any colour vision (Okabe & Ito 2008, https://jfly.uni-koeln.de/color/).

Beside them line styles and markers say what is what, so that a print in grey can be read.
"""

from __future__ import annotations

BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY = "#CC79A7", "#56B4E9"
GREY = "#404040"
"""What is uncompensated; dark, because a medium grey and the green are one colour to who sees no red."""
SHADE = "0.90"
"""Areas behind curves."""
CYCLE = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY)
"""Curves that are all of one kind, in this order; they begin anew where there are more."""
STYLES = ("-", "--", "-.", ":")
"""Their lines: curves that lie on each other are seen both."""
