"""Plugins by entry point: found, loaded and validated."""
