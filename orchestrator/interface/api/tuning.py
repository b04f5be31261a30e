"""Tuning of a drive from the results of a run."""

from __future__ import annotations

import shlex
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.interface.api.analysing import Effects, chosen_effects
from orchestrator.interface.api.exporting import motor_and_recording, winding_c
from orchestrator.interface.api.threads import one_thread
from orchestrator.recording import has_model, read_model
from protocols import Basis, InputError, Motor, Remark, Usability

if TYPE_CHECKING:
    from orchestrator.tuning import TuningReport
    from protocols import FluxMap, Manifest, MotorModel

DEFAULT_RESISTANCE_ERROR_RATIO: float = 0.1
"""Standard deviation of a resistance that was not measured, relative to it: a nameplate's tolerance."""


@one_thread()
def tune(
    place: str | PathLike[str],
    *,
    out: str | PathLike[str] | None = None,
    motor: Motor | str | PathLike[str] | None = None,
    current_a: float | None = None,
    bus_v: float | None = None,
    speed_rpm: float | None = None,
    sampling_hz: float | None = None,
    pwm_hz: float | None = None,
    magnet_percent_per_k: float | None = None,
    effects: Effects = (),
) -> TuningReport:
    """Current references, current control, compensation and sensorless limits, with their C code.

    Parameters
    ----------
    place : path
        A run or recording with a flux map; or a map file, with a motor and a bus voltage.
    out : path, optional
        Folder to write to; by default ``tuning/`` beside the source.
    motor : Motor or path, optional
        The motor, or a YAML file with it, for a map file without one.
    current_a : float, optional
        Largest current [A peak]; by default the rated one as far as it was measured.
    bus_v : float, optional
        DC bus voltage [V]; by default the recording's.
    speed_rpm : float, optional
        Largest mechanical speed [1/min]; by default the rated one.
    sampling_hz : float, optional
        Frequency of the current control [Hz]; by default the PWM's. Its delay follows from it.
    pwm_hz : float, optional
        PWM frequency [Hz]; by default the recording's. The inverter's loss follows from it.
    magnet_percent_per_k : float, optional
        Change of the magnet's flux over its temperature [%/K], such as -0.11 of neodymium, for code with that argument.
    effects : path, effect, or sequence of effects
        Effects of your own that the model has.

    Raises
    ------
    InputError
        Where there is no usable map, no motor or no resistance, or the limits exclude each other; nothing is written.
    StorageError
        Where a file cannot be written.
    """
    from orchestrator.flux_maps import load_map, with_magnet
    from orchestrator.runs import refuse_file
    from orchestrator.tuning import Compensation, Machine, limits_of, no_compensation, require_known, write_tuning
    from orchestrator.tuning import tune as tune_drive

    path = Path(place)
    folder = Path(out) if out is not None else (path if path.is_dir() else path.parent) / "tuning"
    refuse_file(folder)
    flux_map = load_map(path)
    chosen, recording = motor_and_recording(path, motor)
    flux_map = with_magnet(flux_map, chosen)
    manifest, model, std, remarks = _context(path)
    drive = None if manifest is None else manifest.drive
    limits_given = {
        "current_a": current_a,
        "bus_v": bus_v,
        "speed_rpm": speed_rpm,
        "sampling_hz": sampling_hz,
        "pwm_hz": pwm_hz,
    }
    require_known(path, chosen, flux_map, drive, limits_given)
    ohm = chosen.stator_resistance_ohm
    assert ohm is not None
    std = std or chosen.stator_resistance_std_ohm or DEFAULT_RESISTANCE_ERROR_RATIO * ohm
    magnet_per_k = None if magnet_percent_per_k is None else 0.01 * magnet_percent_per_k
    machine = Machine(chosen, flux_map, ohm, std, winding_c(path), magnet_per_k)
    limits = limits_of(machine, drive, **limits_given)
    compensation = no_compensation(limits.current_a)
    if model is not None and manifest is not None:
        compensation = Compensation.of(
            model,
            chosen_effects(effects),
            manifest,
            limits.current_a,
            pwm_frequency_hz=limits.pwm_hz,
            clarke_of_three=_clarke_of_three(path),
        )
    tuning = tune_drive(machine, limits, compensation, _injection_map(path))
    return write_tuning(tuning, folder, recording, remarks)


def _injection_map(path: Path) -> FluxMap | None:
    """The best map that rests on injection, where a folder has one."""
    from orchestrator.estimation import RECOMMENDED_MAP, load_estimates, load_flux_map

    if not path.is_dir():
        return None
    estimates = load_estimates(path)
    method = next((name for name, one in estimates.maps.items() if one.basis is Basis.INJECTION), None)
    if method is None:
        return None
    name = estimates.files.get("flux_map" if method == estimates.method else f"flux_map_{method}")
    return None if name is None else load_flux_map((path / RECOMMENDED_MAP).parent / name)


def _clarke_of_three(path: Path) -> bool | None:
    """Whether the drive's current vectors were made of three readings; None where a recording does not tell."""
    from orchestrator.diagnosis.weak_form.segments import clarke_of_three
    from orchestrator.runs import open_any

    recording = open_any(path)
    capture = recording.load(recording.manifest.segments[0])
    return None if capture.i_abc is None else clarke_of_three(capture.i_ab, capture.i_abc)


def _way_to_a_usable_map(path: Path) -> str:
    """The command that makes the map usable again after `remove`, else the one that has the reasons or finds them."""
    from orchestrator.diagnosis import load_diagnosis, removed_effects

    place, saved = shlex.quote(str(path)), load_diagnosis(path)
    removed = removed_effects(saved.report, read_model(path)) if saved is not None and has_model(path) else ()
    if removed:
        return f"`fluxbench add {place} {' '.join(removed)}` puts back what was removed since the diagnosis"
    if saved is not None:
        return f"`fluxbench explain {place}` has the reasons"
    return f"`fluxbench diagnose {place}` looks for the cause"


def _context(path: Path) -> tuple[Manifest | None, MotorModel | None, float | None, list[Remark]]:
    """The manifest, the diagnosed model and the standard deviation of R_s [ohm], where a folder has them; remarks."""
    from orchestrator.estimation import load_estimates
    from orchestrator.runs import open_any

    if not path.is_dir():
        return None, None, None, []
    estimates = load_estimates(path)
    if estimates.usability is Usability.NOT_USABLE:
        why = next((check.remark.text for check in estimates.checks if not check.is_met), "a check failed")
        raise InputError(str(path), "flux map", f"not usable: {why}; {_way_to_a_usable_map(path)}")
    resistance = estimates.resistance
    std = None if resistance is None else (resistance.high - resistance.low) / 3.92
    model, remarks = read_model(path) if has_model(path) else None, []
    if model is None:
        text = "not diagnosed: nothing is known to compensate; `fluxbench diagnose {run}` looks for it"
        remarks.append(Remark.of("not_diagnosed", text, run=str(path)))
    elif estimates.usability is Usability.NOT_JUDGED:
        text = "the map is not judged: `fluxbench explain {run}` has the reasons"
        remarks.append(Remark.of("map_not_judged", text, run=str(path)))
    return open_any(path).manifest, model, std, remarks
