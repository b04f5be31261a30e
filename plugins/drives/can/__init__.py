"""The drive `can`: the project's own protocol on a CAN bus, classic or FD."""

from plugins.drives.can.drive import CanDrive, CanOptions

__all__ = ["CanDrive", "CanOptions"]
