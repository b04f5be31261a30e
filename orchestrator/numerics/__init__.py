"""General mathematics: frames, splines, surfaces, statistics, and least squares with estimated variances."""
