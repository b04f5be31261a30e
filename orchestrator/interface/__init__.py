"""The command line, the Python interface, what both print of two runs, and templates of new plugins."""
