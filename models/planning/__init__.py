"""From a part program to a trajectory: G-code, point lists, blends, speed profiles, reachability."""
