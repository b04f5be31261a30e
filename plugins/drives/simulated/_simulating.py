"""Measurements of a simulated motor with chosen effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

from orchestrator.interface.api import Measurements, run
from protocols import InputError, Limits, Motor


def simulate(
    motor: str | PathLike[str] | Motor | None = None,
    effects: Mapping[str, Mapping[str, float]] | None = None,
    *,
    plant: Mapping[str, Any] | None = None,
    procedure: str | PathLike[str] = "quick",
    settings: Mapping[str, Any] | None = None,
    out: str | PathLike[str] | None = None,
    streams: Sequence[str] = (),
) -> Measurements:
    """Run a procedure on the simulated drive; the truth is sealed, as in any run.

    Parameters
    ----------
    motor : path or Motor, optional
        A YAML file with the nameplate and, optionally, limits; or the nameplate, whose `usual_limits` then
        apply. Default: the procedure's own motor.
    effects : mapping, optional
        Parameters by effect: ``{"dead_time": {"voltage_v": 1.5}}``; by default no effects.
    plant : mapping, optional
        Other options of the plant: ``{"model": "runs/x/model.json"}``, ``{"sensors": {"noise_a": 0.002}}``.
    procedure, settings, out, streams
        As for `run`.

    Raises
    ------
    FluxbenchError
        As `run`.
    """
    overrides: dict[str, Any] = {
        "drive.plant": {**(plant or {}), "effects": dict(effects or {})},
        "drive.watchdog_s": 10.0,  # simulated hardware cannot be damaged, and the host may be busy
    }
    if isinstance(motor, Motor):
        overrides["motor"] = motor.model_dump(mode="json", exclude_none=True)
        overrides["limits"] = usual_limits(motor).model_dump(mode="json", exclude_none=True)
        motor = None
    return run(
        procedure, drive="simulated", motor=motor, settings={**overrides, **(settings or {})}, out=out, streams=streams
    )


def usual_limits(motor: Motor) -> Limits:
    """Limits for a saturated motor: 2.2 times the rated current and 1.05 times the rated voltage.

    Raises
    ------
    InputError
        Where the nameplate lacks either.
    """
    if motor.rated_current_a is None or motor.rated_voltage_rms_v is None:
        field = "rated_voltage_rms_v" if motor.rated_voltage_rms_v is None else "rated_current_rms_a"
        raise InputError("motor", field, "the limits are derived from it: give it, or a file that states limits")

    def rounded(value: float) -> float:
        return float(f"{value:.3g}")

    return Limits(current_a=rounded(2.2 * motor.rated_current_a), voltage_v=rounded(1.05 * motor.rated_voltage_rms_v))
