"""How fast things are: run by `make bench`, prints ratios, gates nothing."""
