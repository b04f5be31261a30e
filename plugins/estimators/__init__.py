"""Built-in estimators, one file or folder each."""
