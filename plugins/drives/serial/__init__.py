"""The drive `serial`: the project's own protocol on a serial line, a pseudo-terminal or a socket."""

from plugins.drives.serial.drive import SerialDrive, SerialOptions

__all__ = ["SerialDrive", "SerialOptions"]
