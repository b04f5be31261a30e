"""Built-in effects, one file or folder each."""
