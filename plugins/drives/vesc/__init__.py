"""The drive `vesc`: a VESC with its stock firmware, held currents and an injection at zero current in sampled rows."""

from plugins.drives.vesc.drive import VescDrive, VescOptions

__all__ = ["VescDrive", "VescOptions"]
