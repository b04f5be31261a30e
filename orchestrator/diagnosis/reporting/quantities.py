"""Quantities as an engineer reads them: prefixed units, no exponents, words instead of a parameter's name."""

from __future__ import annotations

_SUFFIXES = ("_a", "_v", "_s", "_ohm", "_rad", "_wb", "_per_watt", "_per_a2", "_per_nm")
_UNITS = {"1": "", "1/W": " per W", "1/A^2": " per A²", "ohm": " Ω", "rad/Nm": " rad/Nm"}


def in_volts(value: float | None) -> str:
    """Three digits in µV, mV, V or kV; a dash where there is no number."""
    if value is None:
        return "-"
    for scale, unit in ((1e3, "kV"), (1.0, "V"), (1e-3, "mV")):
        if abs(value) >= 0.9995 * scale:
            return f"{_digits(value / scale)} {unit}"
    return f"{_digits(value * 1e6)} µV"


def in_its_unit(value: float, unit: str) -> str:
    """Four digits and the unit, as one writes it."""
    return f"{value:.4g}{_UNITS.get(unit, f' {unit}')}"


def parameter_words(name: str) -> str:
    """A parameter's name without its unit: bias_a_v -> bias a, rise_per_watt -> rise."""
    for suffix in _SUFFIXES:
        if name.endswith(suffix) and len(name) > len(suffix):
            return name.removesuffix(suffix).replace("_", " ")
    return name.replace("_", " ")


def _digits(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 999.5 else f"{value:.0f}"
