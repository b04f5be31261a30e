"""Mathematics without motors: frames, splines, surfaces, and least squares with variances estimated from the data."""
