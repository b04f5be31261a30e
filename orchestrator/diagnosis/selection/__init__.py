"""Which effects the data ask for, which of them they can tell apart, and what is left when they are in."""
