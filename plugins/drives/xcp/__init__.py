"""The drive `xcp`: an ECU by XCP on Ethernet, with fluxbench's C file in its fast routine."""

from plugins.drives.xcp.drive import XcpDrive, XcpOptions

__all__ = ["XcpDrive", "XcpOptions"]
