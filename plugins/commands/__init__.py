"""Built-in commands beside the main ones, one folder each."""
