"""What `fluxbench tune` states, and its files: everything is computed before the first is written."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from orchestrator.flux_maps import ROOM_C
from orchestrator.formatting.names import code_identifier
from orchestrator.formatting.quantities import quantity
from orchestrator.recording import replace_file
from orchestrator.tuning.c_code import c_files, source_values
from orchestrator.tuning.c_code_int32 import c_files_int32
from orchestrator.tuning.current_control import MIN_PHASE_MARGIN_RAD, phase_margin_at
from orchestrator.tuning.drive_tuning import DriveTuning
from orchestrator.tuning.firmware_settings import settings_for_firmware
from orchestrator.tuning.losses import loss_basis
from orchestrator.tuning.pictures import tuning_picture
from orchestrator.tuning.sensorless import MAX_POSITION_ERROR_RAD, Sensorless
from protocols import InputError, Number, RecordingError, Remark, StorageError, Strict

MARGIN_SPEEDS = 11
"""Speeds at which the phase margin is stated."""

PLACEHOLDER_MOTOR = ("unknown", 1)
"""Name and pole pairs of the motor in a mapping that was guessed without a nameplate."""


class TuningReport(Strict):
    """`tuning.json`: the tuning of a drive for one motor. Peak-valued vectors, electrical angles, mechanical speeds."""

    motor: str
    recording: str
    method: str
    """Method of the flux map."""
    current_limit_a: float
    bus_v: float
    sampling_hz: float
    """Of the current control."""
    pwm_hz: Number = None
    largest_torque_nm: float
    base_speed_rpm: float
    """Up to which the largest torque is available; may be above the largest speed."""
    largest_speed_rpm: float
    torque_at_largest_speed_nm: float
    bandwidth_hz: float
    """Of the current control."""
    phase_margin_deg: float
    """At standstill; the fed-back j omega psi takes from it with speed."""
    least_phase_margin_deg: float
    """The same over the map's 95 % band."""
    margin_speeds_rpm: tuple[float, ...]
    """Speeds from standstill to the largest one."""
    margins_deg: tuple[float, ...]
    """Least phase margin over the map's 95 % band at each of them."""
    integral_hz: float
    """Bandwidth of the integral part."""
    integral_limit_v: float
    """Length to which the integral part is limited; it observes the voltage that was given, and does not wind up."""
    r_s_ohm: float
    r_s_at_c: float
    """Resistance of a phase, and the winding's temperature at which it holds; 20 °C where that is not known."""
    r_s_temperature_is_assumed: bool = False
    """Whether the temperature is not known, so that it is 20 °C."""
    nameplate_magnet_wb: Number = None
    """The magnet's flux where it is the nameplate's: torque, MTPA and speeds rest on it; null where it was measured."""
    k_p_v_per_a: tuple[float, float] | None = None
    """Proportional gains of plain PI controllers of i_d and i_q: the bandwidth times the least inductance [V/A]."""
    least_inductance_h: tuple[float, float] | None = None
    """Least incremental inductances towards d and q within the current limit [H]."""
    least_inductance_at_a: tuple[tuple[float, float], tuple[float, float]] | None = None
    """i_d and i_q of each of them [A]."""
    rest_inductance_h: tuple[float, float] | None = None
    """The same inductances without current [H]."""
    k_i_v_per_as: Number = None
    """Their integral gain: the bandwidth times R_s [V/(A s)]."""
    delay_s: float
    """From sampling to the mean of the voltage."""
    compensated: tuple[str, ...]
    """Effects of the model that the code compensates."""
    left_out: dict[str, str]
    """Effects of the model that it does not, with the reason."""
    lost_v: float
    """Voltage of a leg that the inverter loses at the largest current, at this bus voltage [V]."""
    lost_in_proportion_to_bus_v: Number = None
    """The part of it in proportion to the bus voltage; the rest is lost at any bus voltage [V]."""
    lost_time_s: Number = None
    """Effective dead time: that part over bus voltage and PWM frequency; it makes up for nothing of the rest [s]."""
    constant_inductance_error_percent: float
    """Torque error of references from constant inductances, rms over the largest torque."""
    low_speed_rpm: float
    """Speed at which the harmonics are simulated."""
    harmonics_percent: float
    """5th and 7th harmonic of the phase current over the fundamental, with the compensation at its 95 % edge."""
    harmonics_without_percent: float
    """The same without compensation."""
    injection_works_percent: Number
    """Part of the measured plane within the current limit where a tracking by injection works."""
    injection_error_deg: Number
    """Largest position error of injection by cross-saturation at the references of least current, as far as injection
    works there; null where it works at none."""
    injection_error_at_a: tuple[float, float] | None
    """i_d and i_q of that error."""
    injection_within_limit_a: Number = None
    """|i| of these references up to which that error stays within 5 degrees; null where it does not at the least."""
    injection_fails_at_a: tuple[float, float] | None = None
    """Least of the references of least current at which it does not work; null where it works at all of them."""
    injection_left_by_map_deg: Number
    """Largest error at these references that is left after a compensation by the code's table of inductances."""
    observer_speed_rpm: Number
    """From which a back-EMF observer stays within 5 degrees at those references; null where it never does."""
    observer_speed_warm_rpm: Number
    """The same with a winding that has warmed by 50 K unnoticed."""
    remarks: tuple[Remark, ...] = ()
    files: tuple[str, ...] = ()
    """Names of the written files."""


def report_of(tuning: DriveTuning, recording: str) -> TuningReport:
    """The report, without files."""
    control, limits, sensorless = tuning.control, tuning.limits, tuning.sensorless
    compensation = tuning.compensation
    plane = np.stack(np.meshgrid(sensorless.i_d_a, sensorless.i_q_a, indexing="ij"), axis=-1)
    inside = tuning.machine.inside(plane.reshape(-1, 2)).reshape(plane.shape[:2])
    inside &= np.linalg.norm(plane, axis=-1) <= limits.current_a
    works = sensorless.works & inside
    used = _usable_references(sensorless)
    error = np.abs(sensorless.operating_error_rad[:used])
    worst = sensorless.operating_dq_a[int(error.argmax())].tolist() if used else None
    speeds = np.linspace(0.0, tuning.largest_speed_rad_s, MARGIN_SPEEDS).tolist()
    of_bus_v, of_any_bus_v = compensation.lost_parts_v(limits.bus_v)
    d, q = control.least
    return TuningReport(
        motor=tuning.machine.motor.name,
        recording=recording,
        method=tuning.machine.flux_map.method,
        current_limit_a=limits.current_a,
        bus_v=limits.bus_v,
        sampling_hz=limits.sampling_hz,
        pwm_hz=limits.pwm_hz,
        largest_torque_nm=tuning.largest_torque_nm,
        base_speed_rpm=tuning.rpm(tuning.base_speed_rad_s),
        largest_speed_rpm=tuning.rpm(tuning.largest_speed_rad_s),
        torque_at_largest_speed_nm=float(
            np.interp(tuning.largest_speed_rad_s, tuning.speeds_rad_s, tuning.torque_curve_nm)
        ),
        bandwidth_hz=control.bandwidth_rad_s / (2.0 * math.pi),
        phase_margin_deg=control.phase_margin_deg,
        least_phase_margin_deg=control.least_phase_margin_deg,
        margin_speeds_rpm=tuple(tuning.rpm(speed) for speed in speeds),
        margins_deg=tuple(math.degrees(phase_margin_at(control, speed)) for speed in speeds),
        integral_hz=control.integral_rad_s / (2.0 * math.pi),
        integral_limit_v=limits.voltage_v,
        r_s_ohm=control.r_s_ohm,
        r_s_at_c=ROOM_C if control.winding_c is None else control.winding_c,
        r_s_temperature_is_assumed=control.winding_c is None,
        nameplate_magnet_wb=tuning.machine.rest_flux_wb if tuning.machine.magnet_is_nameplates else None,
        k_p_v_per_a=(control.bandwidth_rad_s * d.inductance_h, control.bandwidth_rad_s * q.inductance_h),
        least_inductance_h=(d.inductance_h, q.inductance_h),
        least_inductance_at_a=((d.i_d_a, d.i_q_a), (q.i_d_a, q.i_q_a)),
        rest_inductance_h=(d.at_rest_h, q.at_rest_h),
        k_i_v_per_as=control.bandwidth_rad_s * control.r_s_ohm,
        delay_s=control.delay_s,
        compensated=compensation.sources,
        left_out={one.name: one.reason for one in compensation.left_out},
        lost_v=of_bus_v + of_any_bus_v,
        lost_in_proportion_to_bus_v=of_bus_v,
        lost_time_s=of_bus_v / limits.bus_v / limits.pwm_hz,
        constant_inductance_error_percent=tuning.benefits.torque_error_percent,
        low_speed_rpm=tuning.rpm(tuning.benefits.speed_rad_s),
        harmonics_percent=tuning.benefits.harmonics_percent,
        harmonics_without_percent=tuning.benefits.harmonics_without_percent,
        injection_works_percent=100.0 * float(works.sum()) / float(inside.sum()) if inside.any() else None,
        injection_error_deg=None if worst is None else math.degrees(float(error.max())),
        injection_error_at_a=None if worst is None else (worst[0], worst[1]),
        injection_within_limit_a=_within_limit_a(sensorless, used),
        injection_fails_at_a=None if used == len(sensorless.operating_works) else _at(sensorless, used),
        injection_left_by_map_deg=_finite(math.degrees(sensorless.left_by_map_rad)),
        observer_speed_rpm=_finite(tuning.rpm(sensorless.least_speed_rad_s)),
        observer_speed_warm_rpm=_finite(tuning.rpm(sensorless.least_speed_warm_rad_s)),
        remarks=tuple(_remarks(tuning)),
    )


def write_tuning(tuning: DriveTuning, out: Path, recording: str, remarks: Sequence[Remark] = ()) -> TuningReport:
    """Write report, tables, picture and C code into a folder; each file is replaced atomically.

    Parameters
    ----------
    remarks : sequence of Remark
        On the map, before those of the tuning.

    Raises
    ------
    StorageError
        Where the folder or a file cannot be written.
    """
    code, on_code = _c_files(tuning)
    contents = {
        "references.csv": _references_csv(tuning),
        "torque.csv": _torque_csv(tuning),
        "compensation.csv": _compensation_csv(tuning),
        "tuning.svg": tuning_picture(tuning),
        **code,
        **settings_for_firmware(tuning.machine, tuning.limits, tuning.control, tuning.compensation),
    }
    report = report_of(tuning, recording)
    known = {"files": ("tuning.json", *contents), "remarks": (*remarks, *report.remarks, *on_code)}
    report = report.model_copy(update=known)
    contents["tuning.json"] = (report.model_dump_json(indent=2) + "\n").encode()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{out}: cannot be created: {error.strerror or error}; --out names another place") from error
    for name, content in contents.items():
        replace_file(out / name, content)
    return report


def _usable_references(sensorless: Sensorless) -> int:
    """Number of the references, from the least current on, before the first at which injection does not work."""
    fails = ~sensorless.operating_works
    return int(fails.argmax()) if fails.any() else len(fails)


def _within_limit_a(sensorless: Sensorless, used: int) -> float | None:
    """|i| of the last reference before the first whose position error is too large [A]."""
    beyond = np.abs(sensorless.operating_error_rad[:used]) > MAX_POSITION_ERROR_RAD
    count = int(beyond.argmax()) if beyond.any() else used
    return math.hypot(*_at(sensorless, count - 1)) if count else None


def _at(sensorless: Sensorless, index: int) -> tuple[float, float]:
    i_d, i_q = sensorless.operating_dq_a[index].tolist()
    return i_d, i_q


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _c_files(tuning: DriveTuning) -> tuple[dict[str, bytes], list[Remark]]:
    """Source in float, and in int32 where that holds the motor; else a remark."""
    motor = tuning.machine.motor
    parts = (tuning.references, tuning.control, tuning.compensation, tuning.limits, tuning.machine.magnet_per_k)
    symbol = code_identifier(motor.name)
    values = source_values(symbol, motor, *parts, basis=_basis(tuning))
    in_float = c_files(values)
    try:
        return in_float | c_files_int32(values), []
    except InputError as error:
        return in_float, [Remark.of("no_int32_code", "no C code in int32: {reason}", reason=str(error))]


def _basis(tuning: DriveTuning) -> list[str]:
    """What the source's figures rest on: R_s, the magnet's flux, and which part of the compensation is a dead time."""
    limits = tuning.limits
    of_bus_v, of_any_bus_v = tuning.compensation.lost_parts_v(limits.bus_v)
    lost_v = of_bus_v + of_any_bus_v
    lines = list(tuning.machine.basis)
    if lost_v:
        lost = f"inverter's loss: {quantity(lost_v, 'V')} a leg at {quantity(limits.current_a, 'A')}"
        lines.append(f"{lost} and {quantity(limits.bus_v, 'V')} bus")
        time_s = of_bus_v / limits.bus_v / limits.pwm_hz
        lines += [f"... {name}: {text}" for name, text in loss_basis(lost_v, of_bus_v, time_s, limits.pwm_hz)]
    return lines


def load_tuning(folder: Path) -> TuningReport:
    """The report of a folder; raises `RecordingError` where it cannot be read."""
    path = folder / "tuning.json"
    try:
        return TuningReport.model_validate_json(path.read_bytes())
    except OSError as error:
        raise RecordingError(str(path), "", f"cannot be read: {error.strerror or error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise RecordingError(str(path), ".".join(map(str, first["loc"])), first["msg"]) from error


def _remarks(tuning: DriveTuning) -> Iterator[Remark]:
    limits, machine = tuning.limits, tuning.machine
    if (machine.motor.name, machine.motor.pole_pairs) == PLACEHOLDER_MOTOR:
        text = (
            "pole_pairs 1 is a guessed mapping's placeholder; torque and speed scale with it: state the motor (--motor)"
        )
        yield Remark.of("placeholder_pole_pairs", text)
    if not tuning.references.reaches_speed:
        text = "at {current} and {bus} the references reach {reached:.0f} of the {wanted:.0f} rpm wanted"
        yield Remark.of(
            "speed_not_reached",
            text,
            current=quantity(limits.current_a, "A"),
            bus=quantity(limits.bus_v, "V"),
            reached=tuning.rpm(tuning.largest_speed_rad_s),
            wanted=tuning.rpm(limits.speed_rad_s),
        )
    if phase_margin_at(tuning.control, tuning.largest_speed_rad_s) < MIN_PHASE_MARGIN_RAD:
        text = (
            "the phase margin falls below {least:.0f}° with speed; a higher control frequency raises it (--sampling-hz)"
        )
        yield Remark.of("small_phase_margin", text, least=math.degrees(MIN_PHASE_MARGIN_RAD))
    rated = machine.motor.rated_current_a
    if rated is not None and limits.current_a < rated * (1.0 - 1e-6):
        text = "the map ends at {current}, below the rated {rated}: the references end there"
        yield Remark.of(
            "below_rated_current", text, current=quantity(limits.current_a, "A"), rated=quantity(rated, "A")
        )


def _references_csv(tuning: DriveTuning) -> bytes:
    references = tuning.references
    rows = []
    for psi, limit, currents in zip(
        references.psi_limit_wb, references.torque_limit_nm, references.i_dq_a, strict=True
    ):
        rows += [(psi, limit * share, *i_dq) for share, i_dq in zip(references.share, currents, strict=True)]
    return _csv(("psi_limit_wb", "torque_nm", "i_d_a", "i_q_a"), rows)


def _torque_csv(tuning: DriveTuning) -> bytes:
    mechanical = tuning.speeds_rad_s / tuning.machine.pole_pairs
    columns = (mechanical * 30.0 / math.pi, tuning.torque_curve_nm, tuning.torque_curve_nm * mechanical)
    return _csv(("speed_rpm", "torque_nm", "power_w"), zip(*columns, strict=True))


def _compensation_csv(tuning: DriveTuning) -> bytes:
    held = tuning.compensation
    columns = (held.current_a, held.lost_v, held.lost_per_bus_v)
    return _csv(("phase_current_a", "lost_v", "lost_per_bus_v"), zip(*columns, strict=True))


def _csv(names: Sequence[str], rows: Iterable[Sequence[float]]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([f"{float(value):.7g}" for value in row])
    return text.getvalue().encode()
