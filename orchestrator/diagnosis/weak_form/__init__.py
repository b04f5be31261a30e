"""The weak form of the voltage equation: segments as signals, windows, equations, and noise covariance."""
