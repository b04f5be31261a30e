"""The switched inverter and its sensors together, as the step loop takes them."""

from __future__ import annotations

from typing import NamedTuple

from plugins.drives.simulated._sensing import SensingParameters
from plugins.drives.simulated._switching import SwitchingParameters


class BenchParameters(NamedTuple):
    """Plain numbers alone."""

    switching: SwitchingParameters
    sensing: SensingParameters
