"""What makes a model an FMU, or a slave of the master without one."""
