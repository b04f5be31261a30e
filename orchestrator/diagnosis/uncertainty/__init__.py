"""How far a fitted effect may be off, and whether it is the same all through the recording."""
