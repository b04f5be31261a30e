"""A simulated drive with motor, brake and sensors; shares no code with the analysis."""

from plugins.drives.simulated._map import map_motor, map_names
from plugins.drives.simulated._memory import misalignment
from plugins.drives.simulated._simulating import simulate, usual_limits
from plugins.drives.simulated.drive import SimulatedDrive
from plugins.drives.simulated.options import SimulatedOptions
from plugins.drives.simulated.truth import TrueMagnetics, true_flux

__all__ = [
    "SimulatedDrive",
    "SimulatedOptions",
    "TrueMagnetics",
    "map_motor",
    "map_names",
    "misalignment",
    "simulate",
    "true_flux",
    "usual_limits",
]
