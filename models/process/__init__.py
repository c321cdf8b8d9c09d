"""The cutting process: cutting forces, tools, the dexel workpiece."""
