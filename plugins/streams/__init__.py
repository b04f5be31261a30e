"""Built-in streams, one file or folder each."""
