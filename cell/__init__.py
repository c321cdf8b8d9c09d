"""What a milling cell is: components by name, scenario and experiment files, milling, what is measured on the part."""
