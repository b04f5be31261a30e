"""Coverage-guided fuzzing of what comes in from a link; how and what came of it is in docs/robustness.md."""
