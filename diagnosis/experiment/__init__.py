"""What was measured and what is simulated beside it: measured runs, simulations, components driven with measured inputs."""
