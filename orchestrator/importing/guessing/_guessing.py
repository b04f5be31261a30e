"""Write a mapping for a measurement file, with a reason on each line, and try it before returning it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.importing._importing import import_files
from orchestrator.importing._mapping import CsvLayout, ImportedDrive, ImportMapping
from orchestrator.importing._opening import check_file, open_columns, open_source
from orchestrator.importing._rotation import turning
from orchestrator.importing._source import Numbers, Wanted, whole
from orchestrator.importing._stamps import Stamps
from orchestrator.importing._units import FACTORS
from orchestrator.importing._vectors import angle_rad, vectors
from orchestrator.importing.guessing._columns import Columns, columns_of, variables_of
from orchestrator.importing.guessing._map_names import roles_of_map
from orchestrator.importing.guessing._roles import Roles, Signal, roles_of
from orchestrator.importing.guessing._rules import MAX_RULES, Rule, repeated_holds, rules_by_label, rules_by_time
from orchestrator.importing.guessing._stages import Stretch, stretches_of
from orchestrator.importing.guessing._units import RMS
from protocols import InputError, SegmentStage

_RATES_HZ = (500.0, 2e6)
"""Usual sampling rates of drive measurements [Hz]."""
_TIME_UNITS = ("s", "ms", "us", "ns")
_MAX_CURRENT_A, _MAX_VOLTAGE_V = 2000.0, 5000.0
"""Largest credible readings where neither nameplate nor bus is known; larger ones are in mA and mV."""
_MIN_PWM_HZ = 500.0
"""Number below which a PWM frequency is taken for kHz."""
_MIN_KELVIN = 220.0
"""A temperature above it is in K: the coldest bench, which is warmer than the hottest winding in degC."""
_MAX_RATED_RATIO, _MAX_BUS_RATIO = 20.0, 5.0
"""The same over the rated current and the bus voltage, as the import accepts them."""


@dataclass(frozen=True)
class Guess:
    """A mapping as text, and the lines that its reader has to confirm."""

    text: str
    doubts: tuple[str, ...]


class _Lines:
    """Keys and values of the mapping, with a reason for each."""

    def __init__(self) -> None:
        self.data: dict[str, Any] = {}
        self._lines: list[str] = []
        self.doubts: list[str] = []

    def say(self, key: str, value: Any, why: str, doubt: bool = False) -> None:
        self.data[key] = value
        self._lines.append(f"{key}: {_yaml(value)}  # {why}")
        if doubt:
            self.doubts.append(f"{key}: {why}")

    def say_rules(self, rules: list[Rule]) -> None:
        if "pwm_frequency" not in self.data and (repeated := repeated_holds(rules)):
            self.doubts.append(repeated)
        self.data["segments"] = [rule for rule, _ in rules]
        self._lines.append("segments:")
        self._lines += [f"  - {_yaml(rule)}  # {why}" for rule, why in rules]

    @property
    def text(self) -> str:
        return "\n".join(self._lines) + "\n"


def used_columns(data: Any) -> set[str]:
    """The columns that a mapping names, at any depth."""
    used: set[str] = set()
    for key, value in data.items():
        if key in ("column", "segment_column"):
            used.add(value)
        elif key == "columns":
            used |= set(value.values())
        elif isinstance(value, dict):
            used |= used_columns(value)
    return used


def _yaml(value: object) -> str:
    """A value on one line."""
    import yaml

    text = yaml.safe_dump(value, default_flow_style=True, width=10_000, allow_unicode=True, sort_keys=False)
    return str(text).strip().removesuffix("...").strip()


def guess_mapping(path: Path, motor: dict[str, Any] | None = None, drive: ImportedDrive | None = None) -> Guess:
    """Write the mapping for one measurement file.

    Parameters
    ----------
    motor : dict, optional
        The section `motor` of the mapping, where the nameplate is known.
    drive : ImportedDrive, optional
        The section `drive`, where it is known.

    Raises
    ------
    InputError
        One line: the ambiguity, or the reason why the guessed mapping cannot be imported.
    """
    check_file(path)
    columns = columns_of(path)
    roles = roles_of(columns.names, columns.called)
    current, voltage = _both(path, columns, roles)
    lines = _Lines()
    lines.say("format", "fluxbench-import", f"guessed from {path.name}")
    lines.say("version", 1, "of the format")
    lines.say("name", path.stem, "the file's")
    unknown = {"name": "unknown", "pole_pairs": 1}
    why = (
        "not in the file: state pole_pairs and pm_flux_wb before `tune`, torque and speed need both; "
        "a nameplate makes every check sharper"
    )
    lines.say("motor", motor or unknown, "as given" if motor else why, doubt=motor is None)
    if columns.layout is not None:
        layout = columns.layout.csv.model_dump(exclude_defaults=True, mode="json")
        if layout:
            lines.say("csv", layout, columns.layout.why)
    raw = _read(path, columns, roles, current, voltage)
    _say_time(path, lines, columns, roles, raw)
    _say_drive(path, lines, columns, roles, raw, voltage, drive)
    _say_pwm_frequency(lines, roles, raw)
    if "pwm_frequency" not in roles.one and (drive is None or drive.pwm_frequency_hz is None):
        lines.doubts.append(
            "drive: pwm_frequency_hz: not in the file; state it, and a dead time comes in seconds too; segments at "
            "another one have `settings: {pwm_frequency_hz: 20000}`"
        )
    most_a, most_v = _MAX_CURRENT_A, _MAX_VOLTAGE_V
    if motor is not None and "rated_current_rms_a" in motor:
        most_a = _MAX_RATED_RATIO * motor["rated_current_rms_a"]
    if drive is not None:
        most_v = _MAX_BUS_RATIO * drive.dc_bus_voltage_v
    _say_signals(path, lines, columns, raw, ("current", current, "A", most_a), ("voltage", voltage, "V", most_v))
    _say_temperature(lines, columns, roles, raw)
    _say_angle(path, lines, columns, roles, raw)
    _say_segments(path, lines, roles)
    if unused := [name for name in columns.names if name not in used_columns(lines.data)]:
        lines.doubts.append(f"not used: {', '.join(unused)}")
    _try(path, lines)
    return Guess(lines.text, tuple(lines.doubts))


def _both(path: Path, columns: Columns, roles: Roles) -> tuple[Signal, Signal]:
    for what, found in (("currents", roles.current), ("voltages", roles.voltage)):
        if found is None:
            variables = variables_of(columns.names)
            if roles_of_map(variables).is_map:
                problem = f"holds a flux map instead of waveforms: `fluxbench audit {path.name}` checks it"
                raise InputError(str(path), "", problem)
            wanted = {"currents": "ia, ib, ic or id, iq", "voltages": "va, vb, vc, vd, vq or duties"}[what]
            problem = (
                f"no column names identify the {what} ({wanted}): rename them, or write the mapping (docs/import.md); "
                f"the file has {len(columns.names)}:"
            )
            named = [f"{n} ({columns.called[n]})" if n in columns.called else n for n in variables]
            if what == "voltages" and not set(columns.names) - set(_of_roles(roles)):
                problem = (
                    "has currents and no voltages: log the drive's commanded voltages or duties in the same rows, or "
                    "import their file beside this one (`beside` in docs/import.md); the file has"
                )
            if columns.names == ["Time", "Ampl"]:
                problem = "one file per channel (LeCroy): add the other files by an entry of files with beside; it has"
            raise InputError(str(path), "", problem, named)
    assert roles.current is not None
    assert roles.voltage is not None
    return roles.current, roles.voltage


def _of_roles(roles: Roles) -> list[str]:
    """The columns whose names say what they are."""
    signals = [signal for signal in (roles.current, roles.voltage) if signal is not None]
    return [*roles.one.values(), *(name for signal in signals for name in signal.columns.values())]


def _read(path: Path, columns: Columns, roles: Roles, *signals: Signal) -> dict[str, Numbers]:
    """The columns of numbers that have a role, as they are in the file."""
    names = [name for signal in signals for name in signal.columns.values()]
    names += [roles.one[role] for role in ("bus", "temperature", "angle", "pwm_frequency") if role in roles.one]
    layout = CsvLayout() if columns.layout is None else columns.layout.csv
    time = roles.one.get("time")
    if time is not None:
        try:
            return dict(whole(path, open_columns(path, Wanted((*dict.fromkeys(names), time)), layout)).numbers)
        except InputError as error:
            if error.field != time:
                raise
    # No time column, or one of texts.
    return dict(whole(path, open_columns(path, Wanted(tuple(dict.fromkeys(names))), layout)).numbers)


def _say_time(path: Path, lines: _Lines, columns: Columns, roles: Roles, raw: dict[str, Numbers]) -> None:
    name = roles.one.get("time")
    increment = columns.layout.increment_s if columns.layout is not None else None
    if name is None or increment:
        if not increment:
            raise InputError(str(path), "", "no column of time, and no sampling frequency in the file")
        lines.say("sampling_frequency_hz", round(1.0 / increment, 9), "the increment in the preamble")
        return
    if name not in raw:
        lines.say("time", {"column": name, "unit": "iso"}, "texts that are dates")
        return
    steps = np.diff(raw[name][np.isfinite(raw[name])])
    # Seconds since an epoch resolve a single step coarsely, so the mean of all steps without gaps counts.
    step = float(np.mean(steps[np.abs(steps) < 1.5 * np.median(np.abs(steps))])) if steps.size else 0.0
    fitting = [u for u in _TIME_UNITS if step > 0 and _RATES_HZ[0] <= 1.0 / (step * FACTORS[u]) <= _RATES_HZ[1]]
    given = columns.units.get(name)
    if given in _TIME_UNITS or given == "min":
        why = f"the file gives the unit; {1.0 / (step * FACTORS[given]):.6g} Hz"
        lines.say("time", {"column": name, "unit": given}, why)
        return
    if fitting[:1] == ["s"] and len(fitting) > 1:
        rate = f"{1.0 / step:.6g} Hz"
        lines.say(
            "time", {"column": name, "unit": "s"}, f"steps of {step:.6g}: {rate} in s; not in the file", doubt=True
        )
        return
    if step == 1.0 or len(fitting) != 1:
        problem = f"steps of {step:g} may be {' or '.join(fitting)}" if fitting else f"steps of {step:g} are no time"
        raise InputError(str(path), name, f"{problem}; the unit of time is unknown")
    why = f"steps of {step:.6g}: only in {fitting[0]} a usual rate, {1.0 / (step * FACTORS[fitting[0]]):.6g} Hz"
    lines.say("time", {"column": name, "unit": fitting[0]}, why)


def _say_drive(
    path: Path,
    lines: _Lines,
    columns: Columns,
    roles: Roles,
    raw: dict[str, Numbers],
    voltage: Signal,
    drive: ImportedDrive | None,
) -> None:
    """The drive, as given or with a bus voltage from the file, and the column of the bus."""
    name = roles.one.get("bus")
    unit = columns.units.get(name or "", "V")
    unit = unit if unit in ("V", "mV", "uV", "kV") else "V"
    if drive is not None:
        lines.say("drive", drive.model_dump(exclude_none=True), "as given")
    elif name is not None:
        nominal = float(f"{float(np.nanmedian(raw[name])) * FACTORS[unit]:.3g}")
        lines.say("drive", _drive(nominal), f"the median of {name}")
    elif voltage.is_duty:
        raise InputError(str(path), "", "duties without a column of the bus voltage: their volts are unknown")
    else:
        unit_v = FACTORS.get(columns.units.get(next(iter(voltage.columns.values())), "V"), 1.0)
        values = np.stack([raw[name] for name in voltage.columns.values()])
        is_vector = voltage.frame in ("alpha_beta", "dq")
        largest = float(np.nanmax(np.hypot(*values) if is_vector else np.abs(values))) * unit_v
        why = "not in the file: twice the largest voltage stands here; give the true one"
        lines.say("drive", _drive(float(f"{2.0 * largest:.2g}") or 1.0), why, doubt=True)
    if name is not None:
        lines.say("bus", {"column": name, "unit": unit}, f"the name{' and unit' if name in columns.units else ''}")


def _drive(dc_bus_voltage_v: float) -> dict[str, Any]:
    return {"name": "unknown", "dc_bus_voltage_v": dc_bus_voltage_v, "pwm_frequency_hz": None}


def _say_signals(
    path: Path, lines: _Lines, columns: Columns, raw: dict[str, Numbers], *signals: tuple[str, Signal, str, float]
) -> None:
    """Frame, columns and unit of each signal: its key, its columns, the plain unit and the largest credible value."""
    for key, signal, plain, largest in signals:
        names = list(signal.columns.values())
        values = np.stack([raw[name] for name in names])
        size = float(np.nanmax(np.abs(values)))
        whole_numbers = bool(np.all(values == np.rint(values))) and size > 100.0
        given = {columns.units[name] for name in names if name in columns.units}
        if len(given) > 1:
            raise InputError(str(path), ", ".join(names), f"have different units: {', '.join(sorted(given))}")
        unit, why = plain, f"up to {size:.3g}, as {plain}"
        if signal.is_duty:
            unit, why = "duty" if size <= 1.5 else "duty_percent", f"shares of the bus: up to {size:.3g}"
        elif given:
            unit, why = next(iter(given)), "the file gives the unit"
        elif whole_numbers:
            problem = f"whole numbers up to {size:g}: a converter's counts? the scale factor is unknown"
            raise InputError(str(path), ", ".join(names), problem)
        elif size > largest:
            unit, why = f"m{plain}", f"up to {size:.3g}: too much for {plain}"
        effective = unit.endswith(RMS)
        unit = unit.removesuffix(RMS)
        section: dict[str, Any] = {"frame": signal.frame, "columns": dict(signal.columns), "unit": unit}
        if effective:
            section["scaling"] = "rms"
        elif signal.frame in ("alpha_beta", "dq"):
            section["scaling"] = "amplitude_invariant"
            why += "; the transform is not in the file"
            lines.doubts.append(f"{key}: scaling: amplitude_invariant is the usual one, and not in the file")
        lines.say(key, section, f"by the names; {why}")


def _say_pwm_frequency(lines: _Lines, roles: Roles, raw: dict[str, Numbers]) -> None:
    name = roles.one.get("pwm_frequency")
    if name is None:
        return
    typical = float(np.nanmedian(raw[name]))
    unit = "kHz" if typical < _MIN_PWM_HZ else "Hz"
    found = np.unique(raw[name][np.isfinite(raw[name])])
    why = f"the name; {len(found)} of them" if len(found) > 1 else "the name"
    lines.say("pwm_frequency", {"column": name, "unit": unit}, f"{why}; about {typical:.3g}, as {unit}")


def _say_temperature(lines: _Lines, columns: Columns, roles: Roles, raw: dict[str, Numbers]) -> None:
    name = roles.one.get("temperature")
    if name is None or not np.any(np.isfinite(raw[name])):
        return
    typical = float(np.nanmedian(raw[name]))
    unit = columns.units.get(name, "K" if typical > _MIN_KELVIN else "degC")
    if unit in ("degC", "K"):
        why = "the file gives the unit" if name in columns.units else f"about {typical:.3g}, as {unit}"
        lines.say("temperature", {"column": name, "unit": unit}, f"the name; {why}")


def _say_angle(path: Path, lines: _Lines, columns: Columns, roles: Roles, raw: dict[str, Numbers]) -> None:
    name = roles.one.get("angle")
    if name is None:
        return
    largest = float(np.nanmax(np.abs(raw[name])))
    unit = columns.units.get(name, "rad" if largest <= 2.0 * np.pi + 1e-3 else "deg" if largest <= 360.0 else "")
    if unit not in ("rad", "deg", "turn"):
        raise InputError(str(path), name, f"an angle up to {largest:g}: its unit is unknown")
    why = "the name; that it is electrical is not in the file"
    lines.say("rotor_angle", {"column": name, "unit": unit}, why, doubt=True)


def _say_segments(path: Path, lines: _Lines, roles: Roles) -> None:
    lines.say("split_at_gaps", True, "where samples are missing a segment ends")
    label = roles.one.get("label")
    labelled = {} if label is None else {"segment_column": label}
    mapping = ImportMapping.model_validate({**lines.data, **labelled, "segments": [{"stage": "classical"}]})
    block = whole(path, open_source(path, mapping))
    time_s = Stamps().seconds(mapping, block, 0)
    good = np.all([np.isfinite(x) for x in (time_s, *block.numbers.values())], axis=0)
    if np.count_nonzero(good) < 100:
        raise InputError(str(path), "", "fewer than a hundred complete rows")
    columns = {name: values[good] for name, values in block.numbers.items()}
    time_s = time_s[good]
    if back := np.flatnonzero(np.diff(time_s) < 0.0).tolist():
        problem = f"its time runs backwards: after {time_s[back[0]]:.6g} s comes {time_s[back[0] + 1]:.6g} s"
        raise InputError(str(path), "", f"{problem}; sort the rows, or give each experiment a file or a label")
    bus, pairs = mapping.bus, mapping.motor.pole_pairs
    dc_v = np.full(time_s.size, mapping.drive.dc_bus_voltage_v) if bus is None else columns[bus.column]
    i, v = (vectors(signal, columns, 0.0, pairs, dc_v) for signal in (mapping.current, mapping.voltage))
    if mapping.rotor_angle.column is None and (turned := turning(i, 1.0 / float(np.median(np.diff(time_s))))):
        problem = f"the current turns {turned[0]:.0f} times at {turned[1]:.4g} Hz, and no column is the rotor's angle"
        raise InputError(str(path), "", problem)
    angle = mapping.rotor_angle
    is_spin = angle.column is not None and np.ptp(np.unwrap(angle_rad(angle, columns, pairs))) > 6.0 * np.pi
    largest = float(np.max(np.hypot(*i.T))), float(np.max(np.hypot(*v.T)))
    by_label: dict[str, Stretch | None] = {}
    if label is not None and block.labels is not None:
        codes = block.labels.codes[good]
        present = np.unique(codes)
        if present.size > MAX_RULES:
            lines.doubts.append(
                f"{label}: {present.size} different values are no labels of experiments: waveforms tell them"
            )
            label = None
        else:
            lines.say("segment_column", label, "the name: labels say where segments begin")
            order = sorted(present.tolist(), key=lambda code: int(np.argmax(codes == code)))
            by_label = {block.labels.names[code]: _longest(time_s, i, v, codes == code, largest) for code in order}
    if is_spin:
        lines.say_rules([({"stage": SegmentStage.SPIN.value}, f"{angle.column} goes round more than three times")])
    elif label is not None and by_label:
        lines.say_rules(rules_by_label(by_label))
    else:
        found = stretches_of(time_s, i, v, largest)
        if len(found) > MAX_RULES:
            problem = f"the kind of excitation changes {len(found) - 1} times, which is no log of experiments"
            wanted = "add a column with one label for each kind of experiment (holds, sweeps, injections)"
            raise InputError(str(path), "", f"{problem}; {wanted}")
        lines.say_rules(rules_by_time(found, time_s))


def _longest(time_s: Numbers, i: Numbers, v: Numbers, rows: Any, largest: tuple[float, float]) -> Stretch | None:
    """The stretch of the stage with the longest duration in the rows of one label."""
    found = stretches_of(time_s[rows], i[rows], v[rows], largest) if np.count_nonzero(rows) > 20 else []
    return max(found, key=lambda one: one.end_s - one.start_s, default=None)


def _try(path: Path, lines: _Lines) -> None:
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / "mapping.yaml"
        trial.write_text(lines.text, encoding="utf-8")
        try:
            report = import_files(trial, [path], Path(folder) / "recording")
        except InputError as error:
            where = "" if error.where.startswith(str(trial)) else error.where
            problem = f"the guessed mapping cannot be imported: {error.problem}"
            raise InputError(where or str(path), error.field, problem, error.choices) from None
    lines.doubts.extend(report.notes)
