"""The shapes in which strangers bring a log: files on a desk, and the mapping that somebody wrote for them."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import numpy as np

from orchestrator.numerics.frames import to_dq
from tests.orchestrator.importing.strangers import Desk, Log

Shape = Callable[[Desk, Log], None]

CURRENT = "current: {frame: abc, columns: {a: ia, b: ib, c: ic}, unit: A}\n"
VOLTAGE = "voltage: {frame: abc, columns: {a: va, b: vb, c: vc}, unit: V}\n"
TIME = "time: {column: t, unit: s}\n"


def rules(log: Log) -> str:
    """The lines that tell segments by a column."""
    entries = ", ".join(f"{{label: {stage}, stage: {stage}}}" for stage in dict.fromkeys(log.stage))
    return f"segment_column: what\nsplit_at_gaps: true\nsegments: [{entries}]\n"


def stages(log: Log) -> str:
    """The same, and where the rotor stands."""
    return rules(log) + at_angle(log)


def at_angle(log: Log) -> str:
    return f"rotor_angle: {{value: {log.angle_rad!r}, unit: rad}}\n" if log.angle_rad else ""


def duties(desk: Desk, log: Log) -> None:
    common = 0.1 * np.sin(40.0 * log.t) + 0.5
    legs = {f"d{x[1]}": 100.0 * (common + volts / log.dc) for x, volts in log.volts.items()}
    desk.write("log.csv", {"t": log.t, **log.phases, **legs, "udc": log.dc, "what": log.stage})
    desk.mapping = TIME + CURRENT + "bus: {column: udc, unit: V}\n" + stages(log)
    desk.mapping += "voltage: {frame: abc, columns: {a: da, b: db, c: dc}, unit: duty_percent}\n"


def line_to_line(desk: Desk, log: Log) -> None:
    va, vb, vc = log.volts.values()
    desk.write("log.csv", {"t": log.t, **log.phases, "uab": va - vb, "ubc": vb - vc, "what": log.stage})
    desk.mapping = TIME + CURRENT + stages(log)
    desk.mapping += "voltage: {frame: line_to_line, columns: {ab: uab, bc: ubc}, unit: V}\n"


def counts(desk: Desk, log: Log) -> None:
    # Two converters of 16 bits for +-20 A, whose middles differ.
    raw = {x: np.rint(log.phases[x] / 20.0 * 32768 + middle) for x, middle in zip(("ia", "ib"), (7, -12), strict=True)}
    desk.write("log.csv", {"t": log.t, **raw, **log.volts, "what": log.stage})
    desk.mapping = TIME + VOLTAGE + stages(log)
    desk.mapping += (
        "current: {frame: abc, columns: {a: ia, b: ib}, unit: mA, factor: 0.6103515625, offset: {a: 7, b: -12}}\n"
    )


def ticks(desk: Desk, log: Log) -> None:
    # A counter of 24 bits, at one megahertz: it wraps within the sweep, and more than once in the pauses.
    desk.write(
        "log.csv", {"n": (np.rint(1e6 * log.t) + 5_000_000) % 2**24, **log.phases, **log.volts, "what": log.stage}
    )
    desk.mapping = CURRENT + VOLTAGE + stages(log)
    desk.mapping += "time: {column: n, unit: tick, tick_hz: 1000000, wraps_at: 16777216}\n"


def epoch(desk: Desk, log: Log) -> None:
    stamps = np.rint((1_700_000_000.25 + log.t) * 1e6).astype(np.int64)
    desk.write("log.csv", {"stamp": stamps, **log.phases, **log.volts, "what": log.stage})
    desk.mapping = "time: {column: stamp, unit: us}\n" + CURRENT + VOLTAGE + stages(log)


def dates(desk: Desk, log: Log) -> None:
    begin = datetime(2026, 11, 23, 6, 45, tzinfo=UTC)
    stamps = [(begin + timedelta(microseconds=round(1e6 * t))).isoformat(timespec="microseconds") for t in log.t]
    desk.write("log.csv", {"stamp": stamps, **log.phases, **log.volts, "what": log.stage})
    desk.mapping = "time: {column: stamp, unit: iso}\n" + CURRENT + VOLTAGE + stages(log)


def shaft(desk: Desk, log: Log) -> None:
    # At 0 electrical the encoder reads 77.5 degrees, and it counts the other way round.
    encoder = np.full(log.t.size, 77.5 - np.rad2deg(log.angle_rad) / 2.0)
    i, v = to_dq(log.i, log.angle_rad), to_dq(log.v, log.angle_rad)
    columns = {"t": log.t, "id": i[:, 0], "iq": i[:, 1], "ud": v[:, 0], "uq": v[:, 1], "enc": encoder}
    desk.write("log.csv", {**columns, "what": log.stage})
    desk.mapping = TIME + rules(log)
    desk.mapping += "current: {frame: dq, columns: {d: id, q: iq}, unit: A, scaling: amplitude_invariant}\n"
    desk.mapping += "voltage: {frame: dq, columns: {d: ud, q: uq}, unit: V, scaling: amplitude_invariant}\n"
    desk.mapping += "rotor_angle: {column: enc, unit: deg, offset: 77.5, factor: -1, mechanical: true}\n"


def a_file_a_stage(desk: Desk, log: Log) -> None:
    # Each of another logger: other names, other units, another layout.
    names = {"resistance": "rest", "classical": "ramp", "injection": "hf"}
    for stage, name in names.items():
        part, size = log.of(stage), 1e3 if name == "hf" else 1.0
        current = "I_a" if name == "ramp" else "ia"
        phases = {x.replace("ia", current): size * amps for x, amps in part.phases.items()}
        desk.write(f"{name}_1.csv", {"t": part.t, **phases, **part.volts})
    desk.mapping = TIME + CURRENT + VOLTAGE + at_angle(log) + "split_at_gaps: true\n"
    desk.mapping += "files: [{file: ramp*, columns: {ia: I_a}}, {file: hf*, current: {unit: mA}}]\n"
    desk.mapping += (
        "segments: [{file: rest*, stage: resistance}, {file: ramp*, stage: classical}, {file: hf*, stage: injection}]\n"
    )


def scope_channels(desk: Desk, log: Log) -> None:
    # A file a channel, all with the same names in it below four lines of preamble, as LeCroy's write them.
    preamble = f"LECROYWaveRunner\xff,20113,Waveform\nSegments,1,SegmentSize,{log.t.size}\n"
    preamble += "Segment,TrigTime,TimeSinceSegment1\n#1,14-May-2019 13:29:30,0                 \n"
    for number, values in enumerate([*log.phases.values(), *log.volts.values()], start=1):
        path = desk.write(f"C{number}--00000.csv", {"Time": log.t, "Ampl": values, "what": log.stage})
        path.write_bytes(preamble.encode("latin-1") + path.read_bytes())
    named = zip(("ib", "ic", "va", "vb", "vc"), range(2, 7), strict=True)
    beside = [f"{{file: C{k}*, beside: C1*, columns: {{{name}: Ampl}}}}" for name, k in named]
    desk.mapping = "time: {column: Time, unit: s}\n" + CURRENT + VOLTAGE + stages(log)
    desk.mapping += "csv: {skip_rows: 4, encoding: latin-1}\n"
    desk.mapping += f"files: [{{file: C1*, columns: {{ia: Ampl}}}},\n  {', '.join(beside)}]\n"


def two_loggers(
    desk: Desk, log: Log, offset_s: float = -37.25, ppm: float = 40.0, rate_hz: float = 1e5, step_s: float = 1e-4
) -> None:
    """Currents by one logger; voltages by another, of another rate, with a clock of its own."""
    desk.write("amps.csv", {"t": log.t, **log.phases, "what": log.stage})
    fine = np.arange(log.t[0], log.t[-1], 1.0 / rate_hz)
    row = np.clip(np.searchsorted(log.t, fine + 1e-9, side="right") - 1, 0, None)
    quiet = fine - log.t[row] > 1.5 * step_s
    volts = {x: np.where(quiet, 0.0, u[row]) for x, u in log.volts.items()}
    desk.write("volts.csv", {"time_ms": 1e3 * (fine * (1.0 + 1e-6 * ppm) + offset_s), **volts})
    desk.mapping = TIME + CURRENT + VOLTAGE + stages(log)
    desk.mapping += "files: [{file: volts*, beside: amps*, columns: [va, vb, vc], align: edges, "
    desk.mapping += "time: {column: time_ms, unit: ms}}]\n"


def one_axis(desk: Desk, log: Log, alone: str = "d") -> None:
    """Voltage steps on d, on q and on both at once, a file each; where one axis was stepped it has that alone."""
    ends = np.flatnonzero(np.diff(log.t, append=np.inf) > 1.5 * (log.t[1] - log.t[0])) + 1
    i, v = to_dq(log.i, log.angle_rad), to_dq(log.v, log.angle_rad)
    for number, (first, end) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
        here = slice(int(first), int(end))
        stepped = "".join("dq"[axis] for axis in range(2) if np.abs(v[here, axis]).max() > 1e-6)
        on = ["dq".index(stepped)] if len(stepped) == 1 and stepped in alone else [0, 1]
        axes = {f"{x}{'dq'[k]}": y[here, k] for k in on for x, y in (("i", i), ("u", v))}
        desk.write(f"{stepped}_{number}.csv", {"t": log.t[here], **axes})
    full = "{{frame: dq, columns: {{d: {0}d, q: {0}q}}, unit: {1}, scaling: amplitude_invariant}}\n"
    only = "{{columns: {{{1}: {0}{1}}}, other_axis: zero}}"
    desk.mapping = TIME + f"current: {full.format('i', 'A')}voltage: {full.format('u', 'V')}" + at_angle(log)
    one = [f"{{file: {a}_*, current: {only.format('i', a)}, voltage: {only.format('u', a)}}}" for a in alone]
    desk.mapping += f"files: [{', '.join(one)}]\nsegments: [{{stage: steps}}]\n"


def each_axis_alone(desk: Desk, log: Log) -> None:
    """The same with i_d missing where q was stepped: it was not nothing there."""
    one_axis(desk, log, "dq")


def matlab_struct(desk: Desk, log: Log) -> None:
    from scipy.io import savemat

    path, names = desk.folder / "log.mat", list(dict.fromkeys(log.stage))
    held = {"t": log.t, "i": np.column_stack(list(log.phases.values())), "v": np.column_stack(list(log.volts.values()))}
    savemat(path, {"log": {**held, "what": np.array([names.index(stage) for stage in log.stage])}})
    desk.files.append(path)
    entries = ", ".join(f"{{label: '{k}', stage: {stage}}}" for k, stage in enumerate(names))
    desk.mapping = "time: {column: log.t, unit: s}\n"
    for name, x, unit in (("current", "i", "A"), ("voltage", "v", "V")):
        columns = ", ".join(f"{phase}: 'log.{x}(:,{k})'" for k, phase in enumerate("abc", start=1))
        desk.mapping += f"{name}: {{frame: abc, columns: {{{columns}}}, unit: {unit}}}\n"
    desk.mapping += f"segment_column: log.what\nsplit_at_gaps: true\nsegments: [{entries}]\n" + at_angle(log)


def switching(desk: Desk, log: Log) -> None:
    """Of a bridge that keeps one state from row to row: its number, and the bus."""
    legs = (np.column_stack(list(log.volts.values())) > 0.0).astype(int)
    states = np.array([[0, 5, 3, 4], [1, 6, 2, 7]])[legs[:, 0], 2 * legs[:, 1] + legs[:, 2]]
    desk.write("log.csv", {"t": log.t, **log.phases, "sv": states, "bus": log.dc, "what": log.stage})
    desk.mapping = TIME + CURRENT + "bus: {column: bus, unit: V}\n" + stages(log)
    desk.mapping += "voltage: {frame: switching, columns: {state: sv}, numbering: sectors, unit: duty}\n"
