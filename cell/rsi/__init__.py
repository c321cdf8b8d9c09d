"""The link to a robot controller by KUKA's robot-sensor interface (RSI): telegrams, watchdog, partner, simulator of the robot's side."""
