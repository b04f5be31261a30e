"""Convert a stretch of rows into a capture and the waveforms for the checks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.importing._angles import believed_angle_rad, check_angle_column
from orchestrator.importing._findings import Finding, Findings
from orchestrator.importing._mapping import ImportMapping
from orchestrator.importing._signals import Temperature
from orchestrator.importing._source import Numbers
from orchestrator.importing._splitting import RawSegment
from orchestrator.importing._timing import Stretch, at, resampled, resampled_held
from orchestrator.importing._units import ZERO_CELSIUS_K
from orchestrator.importing._vectors import Columns, bus_v, phases, temperature_c, vectors, wrong_state
from orchestrator.importing._waveform_checks import Waveforms
from protocols import Capture, InputError, SegmentStage

PLAUSIBLE_TEMPERATURE_C = (-80.0, 250.0)
"""From the coldest climatic chamber to beyond the insulation class of 180 degC."""
_MAX_FLOAT32 = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class UnplacedSegment:
    """A segment on its file's own clock: its capture starts at its first time stamp."""

    capture: Capture
    waveforms: Waveforms
    rotor_angle_rad: float


def segment_of(raw: RawSegment, stretch: Stretch, rate_hz: float, findings: Findings) -> UnplacedSegment:
    """The capture of a stretch (float32), resampled where its time stamps are uneven.

    Raises
    ------
    InputError
        Where an angle's unit is implausible, or a value is out of range.
    """
    mapping = raw.mapping
    columns = {name: values[stretch.part] for name, values in raw.columns.items()}
    rule = mapping.segments[raw.rule]
    rotor, pole_pairs = rule.rotor_angle or mapping.rotor_angle, mapping.motor.pole_pairs
    for angle in (rotor, mapping.current.angle, mapping.voltage.angle):
        if angle is not None:
            check_angle_column(angle, raw, columns, findings)
    believed_rad, theta_rad = believed_angle_rad(rotor, rule.stage, raw, columns, pole_pairs, findings)
    wrong = wrong_state(mapping.voltage, columns)
    if wrong is not None:
        name = mapping.voltage.columns["state"]
        problem = (
            f"expected a switching state from 0 to 7, got {columns[name][wrong]:g} in {at(raw, stretch.rows[wrong])}"
        )
        raise InputError(str(raw.path), name, problem)
    nominal_v = mapping.drive.dc_bus_voltage_v
    dc_v = np.full(len(stretch.rows), nominal_v) if mapping.bus is None else bus_v(mapping.bus, columns)
    i_abc = _phase_currents(mapping, columns)
    signals: dict[str, Numbers | None] = {
        "i_ab": vectors(mapping.current, columns, theta_rad, pole_pairs, dc_v),
        "v_ab": vectors(mapping.voltage, columns, theta_rad, pole_pairs, dc_v),
        "v_dc": dc_v,
        "i_abc": i_abc,
        "temperature_c": None if mapping.temperature is None else temperature_c(mapping.temperature, columns),
    }
    if rule.stage is SegmentStage.SPIN and not isinstance(theta_rad, float):
        signals["theta_rad"] = np.unwrap(theta_rad)
    if stretch.uneven:
        time_s = raw.time_s[stretch.part]
        for name, x in signals.items():
            if x is not None:
                signals[name] = (resampled_held if name == "v_ab" else resampled)(time_s, x, rate_hz)
    _check_bounds(signals, raw, stretch)
    if mapping.temperature is not None:
        _check_temperature(mapping.temperature, _there(signals["temperature_c"]), raw, findings)
    if signals.get("theta_rad") is not None:
        # 32 bits would not resolve an angle of many turns.
        signals["theta_rad"] = np.mod(_there(signals["theta_rad"]), 2.0 * np.pi)
    columns32 = {name: None if x is None else x.astype(np.float32) for name, x in signals.items()}
    capture = Capture(start_s=float(raw.time_s[stretch.rows[0]]), sampling_frequency_hz=rate_hz, **columns32)
    waveforms = Waveforms(
        file=str(raw.path),
        mapping=mapping,
        rows=at(raw, stretch.rows[0]),
        stage=rule.stage,
        rate_hz=rate_hz,
        i_ab=_there(signals["i_ab"]),
        v_ab=_there(signals["v_ab"]),
        v_dc=_there(signals["v_dc"]),
        injected_hz=rule.settings.get("frequency_hz") if rule.stage is SegmentStage.INJECTION else None,
        i_abc=signals["i_abc"],
        raw_currents={name: columns[name] for name in mapping.current.columns.values()},
    )
    return UnplacedSegment(capture, waveforms, believed_rad)


def _phase_currents(mapping: ImportMapping, columns: Columns) -> Numbers | None:
    """The phase currents, where all three were measured."""
    if mapping.phase_currents is not None:
        return phases(mapping.phase_currents, columns)
    if mapping.current.frame == "abc" and len(mapping.current.columns) == 3:
        return phases(mapping.current, columns)
    return None


def _check_temperature(temperature: Temperature, values_c: Numbers, raw: RawSegment, findings: Findings) -> None:
    low, high = PLAUSIBLE_TEMPERATURE_C
    median = float(np.median(values_c))
    if low <= median <= high:
        return
    other = "degC" if temperature.unit == "K" else "K"
    kelvin = ZERO_CELSIUS_K if temperature.unit == "K" else -ZERO_CELSIUS_K
    stated = f"{median + max(kelvin, 0.0):.3g} {temperature.unit}"
    text = f"{stated} is {median:.0f} degC" if temperature.unit == "K" else f"{stated} is no winding's temperature"
    hint = f"; {other} would fit" if low <= median + kelvin <= high else ""
    findings.doubt(Finding.TEMPERATURE_UNIT, str(raw.path), temperature.column, text + hint)


def _check_bounds(signals: dict[str, Numbers | None], raw: RawSegment, stretch: Stretch) -> None:
    for name, values in signals.items():
        if values is not None and not np.max(np.abs(values)) < _MAX_FLOAT32:
            raise InputError(
                str(raw.path),
                name,
                f"beyond what can be a measurement, in the segment from {at(raw, stretch.rows[0])} on",
            )


def _there(values: Numbers | None) -> Numbers:
    assert values is not None  # every recording has currents, voltages and a bus
    return values
