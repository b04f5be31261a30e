"""Who does: drives, estimators, effects and streams, each found by its entry point alone."""
