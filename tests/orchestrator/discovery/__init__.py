"""Laws that no effect of the library has, hidden in a plant of their own; what a discovery says of them."""
