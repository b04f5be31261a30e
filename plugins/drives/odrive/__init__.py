"""The drive `odrive`: an ODrive with firmware 0.5 by its ASCII protocol, holding direct currents."""

from plugins.drives.odrive.drive import OdriveDrive, OdriveOptions

__all__ = ["OdriveDrive", "OdriveOptions"]
