"""A sealed set of recordings, each with one law that no library has: what the search for a law finds of it."""
