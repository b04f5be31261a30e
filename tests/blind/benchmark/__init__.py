"""The frozen set of the benchmark: recordings of the plants, and their truths in the form that is scored."""
