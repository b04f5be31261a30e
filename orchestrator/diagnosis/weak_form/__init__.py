"""The weak form of the voltage equation: segments as signals, windows, the equations they make, and their noise."""
