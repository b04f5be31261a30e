"""What a map's files rest on, a sentence each: R_s with its temperature, and a magnet's flux that was copied."""

from __future__ import annotations

import math

from orchestrator.formatting.quantities import number, quantity
from protocols import Motor

SAME_FLUX_RATIO = 1e-4
"""Relative difference of two fluxes up to which one was copied from the other: no measurement is so close."""
ROOM_C = 20.0
"""Temperature to which data sheets state resistances, for a winding of unknown temperature [°C]."""
_ASCII = {"°C": "degC", "°": " deg", "Ω": "ohm", "µ": "u", "−": "-"}


def magnet_is_copied(motor: Motor, rest_flux_wb: float) -> bool:
    """Whether a map's flux without current is the nameplate's, as in each map of a rotor that stood still."""
    stated = motor.pm_flux_wb
    return bool(stated) and math.isclose(rest_flux_wb, stated or 0.0, rel_tol=SAME_FLUX_RATIO)


def resistance_basis(r_s_ohm: float, winding_c: float | None) -> str:
    """R_s and the temperature of the winding at which it holds; `ROOM_C` where that is not known."""
    source = " (assumed: `run --ambient` states it)" if winding_c is None else ""
    at_c = number(ROOM_C if winding_c is None else winding_c)
    return f"{quantity(r_s_ohm, 'Ω', 4)} a phase with the winding at {at_c} °C{source}"


def magnet_basis(magnet_wb: float) -> str:
    """A magnet's flux that the nameplate has, and what depends on it."""
    return f"{quantity(magnet_wb, 'Wb')}, copied from the nameplate, not from a measurement; torque and MTPA rest on it"


def in_ascii(text: str) -> str:
    """The text for a C source or a settings file."""
    for sign, word in _ASCII.items():
        text = text.replace(sign, word)
    return text.encode("ascii", "replace").decode("ascii")
