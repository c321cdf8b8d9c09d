"""What a law that is in no catalogue is like: a sparse form at the port where the gap arises, put into the closed loop."""
