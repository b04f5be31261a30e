"""Mathematics without a motor in it: frames, splines, surfaces, and least squares with variances that the data tell."""
