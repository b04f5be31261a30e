"""Built-in drives, one file or folder each."""
