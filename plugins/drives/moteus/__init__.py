"""The drive `moteus`: a moteus controller by its own official library, holding direct currents."""

from plugins.drives.moteus._options import MoteusOptions
from plugins.drives.moteus.drive import MoteusDrive

__all__ = ["MoteusDrive", "MoteusOptions"]
