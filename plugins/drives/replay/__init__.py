"""A recording played back as a drive: the same procedure, the same engine, nothing energised."""

from plugins.drives.replay.drive import ReplayDrive, ReplayOptions

__all__ = ["ReplayDrive", "ReplayOptions"]
