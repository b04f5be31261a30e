"""The values without which nothing is tuned: resistance, magnet, bus, control frequency, largest speed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from orchestrator.flux_maps import MapSurface, has_no_rest_flux
from protocols import DriveRecord, FluxMap, InputError, Motor


def require_known(
    path: Path, motor: Motor, flux_map: FluxMap, drive: DriveRecord | None, given: Mapping[str, float | None]
) -> None:
    """Raise `InputError` that names every missing value, and where to state it.

    Parameters
    ----------
    path : Path
        What is tuned, for the message.
    motor : Motor
        With the measured resistance, where there is one.
    flux_map : FluxMap
    drive : DriveRecord or None
        The drive that the motor was measured with.
    given : mapping of str to float
        The limits, by their names in `limits_of`; None where they are not given.
    """
    missing = dict(_missing(motor, flux_map, drive, given))
    if missing:
        raise InputError(str(path), ", ".join(missing), "; ".join(missing.values()))


def _missing(
    motor: Motor, flux_map: FluxMap, drive: DriveRecord | None, given: Mapping[str, float | None]
) -> Iterator[tuple[str, str]]:
    if motor.stator_resistance_ohm is None:
        yield "stator_resistance_ohm", "R_s is unknown: estimate it, or give a motor with it (--motor)"
    if motor.pm_flux_wb is None and has_no_rest_flux(MapSurface(flux_map)):
        yield (
            "pm_flux_wb",
            "unknown, and a locked rotor does not show it: torque and references would be those of the reluctance "
            "alone; state motor.pm_flux_wb (0 without a magnet) and the true pole_pairs in a YAML file (--motor)",
        )
    if given.get("bus_v") is None and drive is None:
        yield "bus_v", "unknown; give the DC bus voltage (--bus-v)"
    without_pwm = given.get("pwm_hz") is None and (drive is None or drive.pwm_frequency_hz is None)
    if given.get("sampling_hz") is None and without_pwm:
        yield "sampling_hz", "unknown; give the frequency of the current control (--sampling-hz)"
    if given.get("speed_rpm") is None and motor.rated_speed_rpm is None and not motor.pm_flux_wb:
        yield "speed_rpm", "unknown; give the largest speed (--speed-rpm)"
