"""Columns of the segment table: what the planner writes and the path interpolator reads.

A row is a time span of constant jerk on one shape. Everything in SI and in the robot base B. The last row is the rest
at the end of the path; a path time behind its beginning stays there.
"""

COLUMNS = 50
TAU, KIND, BLOCK, LINE, SPINDLE, TOOL, SIGMA, SPEED, ACCELERATION, JERK = range(10)
"""Columns: path time at the start [s]; kind of geometry; block (N) number; line of the file; spindle speed [rad/s]; number of the tool,
0 = none named; path coordinate, its speed, acceleration and jerk at the start [m, m/s, m/s2, m/s3; rad in a turn in place]."""
GEOMETRY = 10
"""18 columns. Polynomial: [i*6 + k] = coefficient k of coordinate i.
Helix: centre, radius e1, radius e2, climb (3 each), angle per length."""
QUAT, AXIS_1, F_1, AXIS_2, F_2 = 28, 32, 35, 41, 44
"""Orientation R = R(quat) exp(axis_1 f_1(sigma)) exp(axis_2 f_2(sigma)): quaternion 4, axes 3 each, quintics f [rad] 6 each."""

POLYNOMIAL, HELIX = 0, 1
"""Kinds of geometry: a polynomial of degree up to five in the path coordinate (a line, a piece of a blend, a point), or an arc or helix."""
GEOMETRY_COLUMNS = 18
