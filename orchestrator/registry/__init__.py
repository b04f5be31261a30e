"""Plugins by entry point: found, loaded and held against their contract."""
