"""A recording of the benchmark as one linear regression, for baselines: numpy, scipy and pyarrow alone.

The equation of a motor at standstill, in the operator's dq frame and sample by sample,

    v = R i + dpsi(i)/dt + sum of effects,

is averaged over windows of 10 ms, once as it is and, under injection, multiplied by the injected sine and cosine. psi
is the gradient of a polynomial energy that is even in i_q. Each effect is linear in its size, with its other constants
at a usual value: that is what a linear method can know. Rows are divided by what the sensors' noise makes of them.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

WINDOW_S = 0.01
DEGREE = 8
"""Of the energy."""
PHASES = np.exp(-2j * np.pi / 3 * np.arange(3))[:, None]
HEATING_S, SKIN_HZ = 100.0, 40.0
EXPLAINED_CHI2, EXPLAINED_PART = 2.0, 0.1
"""A misfit counts as explained below this chi2, or where this part of it (rms) is left."""


@dataclass
class Segment:
    """Rows of one segment, complex d + jq."""

    stage: str
    start_s: float
    i: Any
    v: Any
    angle_rad: float
    pwm_ratio: float
    frequency_hz: float | None


@dataclass
class Recording:
    """What a baseline knows of a recording."""

    motor: dict[str, Any]
    hz: float
    noise_a: float
    segments: list[Segment]


def read(folder: Path) -> Recording:
    """Read a recording, or a log by its mapping."""
    if (folder / "log.csv").exists():
        motor, drive, hz, pieces = _read_log(folder)
    else:
        import pyarrow.parquet as pq

        manifest = json.loads((folder / "recording.json").read_text(encoding="utf-8"))
        motor, drive = manifest["motor"], manifest["drive"]
        hz = drive["sampling_frequency_hz"]
        pieces = []
        for s in manifest["segments"]:
            rows = pq.read_table(folder / "captures" / f"{s['id']}.parquet")
            i, v = (rows[f"{n}_alpha"].to_numpy() + 1j * rows[f"{n}_beta"].to_numpy() for n in "iv")
            pieces.append((s["stage"], s["start_s"], s["settings"], s["rotor_angle_rad"], i, v))
    late = round(drive.get("voltage_delay_samples") or 0)
    usual_hz = drive.get("pwm_frequency_hz") or hz
    segments, noises = [], []
    for stage, start_s, settings, angle, i, v in pieces:
        turned, count = np.exp(-1j * angle), len(i) - late
        ratio = settings.get("pwm_frequency_hz", usual_hz) / usual_hz
        if stage in ("gates_off", "resistance"):
            noises.append(float(np.std(np.diff(i))) / 2.0)
        if stage != "gates_off" and count > 3 * round(WINDOW_S * hz):
            hertz = settings.get("frequency_hz") if stage == "injection" else None
            segments.append(Segment(stage, start_s, (i * turned)[late:], (v * turned)[:count], angle, ratio, hertz))
    return Recording(motor, hz, max(float(np.median(noises or [0.0])), 1e-9), segments)


def _read_log(folder: Path) -> tuple[dict[str, Any], dict[str, Any], float, list[Any]]:
    import yaml
    from pyarrow import csv

    mapping = yaml.safe_load((folder / "mapping.yaml").read_text(encoding="utf-8"))
    rows, hz = csv.read_csv(folder / "log.csv"), mapping["sampling_frequency_hz"]
    time_s, labels = rows["time"].to_numpy(), np.array(rows["point"].to_pylist())
    i_u, i_v = (1e-3 * rows[name].to_numpy() for name in ("i_u", "i_v"))
    i, v = i_u + 1j * (i_u + 2 * i_v) / np.sqrt(3), rows["u_alpha"].to_numpy() + 1j * rows["u_beta"].to_numpy()
    rules = {rule["label"]: rule for rule in mapping["segments"]}
    cuts = 1 + np.flatnonzero((np.diff(time_s) > 1.5 / hz) | (labels[1:] != labels[:-1]))
    pieces = []
    for part in np.split(np.arange(len(i)), cuts):
        rule = rules[labels[part[0]]]
        angle = mapping["rotor_angle"]["value"]
        pieces.append((rule["stage"], time_s[part[0]], rule["settings"], angle, i[part], v[part]))
    return mapping["motor"], mapping["drive"], hz, pieces


@dataclass
class Column:
    """One effect's column: its name, the unit of its size, and what a reported size is of its coefficient."""

    name: str
    unit: str
    typical: float
    reported: bool = True
    inverse: bool = False


class Problem:
    """y = base @ b + effects @ x + noise of variance one.

    Attributes
    ----------
    y, base, effects : array
        Shape (rows,), (rows, 1 + polynomials), (rows, columns); R is the first of the base.
    columns : list of Column
    where : array (rows, 3)
        Currents i_d, i_q in units of the rated one, and 1 for rows of ripple.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        motor = recording.motor
        self.rated_a = float(np.sqrt(2.0) * motor["rated_current_rms_a"])
        self.ohm = float(motor["stator_resistance_ohm"])
        self.henry = float(motor["d_inductance_h"]), float(motor["q_inductance_h"])
        self.scale_a = max(float(np.abs([s.i.real, s.i.imag]).max()) for s in recording.segments)
        plain = [self._averaged(s, self._base(s)) for s in recording.segments]
        self.y, self.base, self.where = (np.concatenate([part[k] for part in plain]) for k in range(3))
        first = np.linalg.lstsq(self.base, self.y, rcond=1e-10)[0]
        self.ohm, self._energy = float(first[0]), first[1:]
        self.columns = [column for column, _ in self._effects(recording.segments[0], 0.0)]
        parts, heat_j = [], 0.0
        for s in recording.segments:
            values = np.stack([value for _, value in self._effects(s, heat_j)], axis=1)
            parts.append(self._averaged(s, np.concatenate([s.v[:-1, None], values], axis=1))[1])
            heat_j += 1.5 * self.ohm * float(np.sum(np.abs(s.i) ** 2)) / recording.hz
        self.effects = np.concatenate(parts)

    def _polynomials(self, i: Any, order_d: int, order_q: int) -> Any:
        """Derivatives of the energy's terms over currents in units of `scale_a`, shape (samples, terms)."""
        d, q = i.real / self.scale_a, i.imag / self.scale_a
        unit = np.eye(DEGREE + 1)

        def power(x: Any, n: int, order: int) -> Any:
            return np.polynomial.chebyshev.chebval(x, np.polynomial.chebyshev.chebder(unit[n], order))

        along_d = [power(d, m, order_d) for m in range(DEGREE + 1)]
        along_q = [power(q, n, order_q) for n in range(DEGREE + 1)]
        terms = [along_d[m] * along_q[n] for n in range(0, DEGREE + 1, 2) for m in range(DEGREE + 1 - n) if m + n > 1]
        return np.stack(terms, axis=1)

    def flux_terms(self, i: Any) -> Any:
        """psi of each term, complex, shape (samples, terms)."""
        return self._polynomials(i, 1, 0) + 1j * self._polynomials(i, 0, 1)

    def _base(self, s: Segment) -> Any:
        rise = np.diff(self.flux_terms(s.i), axis=0) * self.recording.hz
        return np.concatenate([s.v[:-1, None], 0.5 * (s.i[1:] + s.i[:-1])[:, None], rise], axis=1)

    def _averaged(self, s: Segment, values: Any) -> tuple[Any, Any, Any]:
        """Windowed rows of y (the first column) and of the others, and where they are; each divided by its noise."""
        hz, length = self.recording.hz, round(WINDOW_S * self.recording.hz)
        count = len(values) // length
        cut = values[: count * length].reshape(count, length, -1)
        window = np.hanning(length + 2)[1:-1]
        window /= window.sum()
        kinds = [(window, 0.0)]
        if s.frequency_hz is not None:
            turn = 2 * np.pi * s.frequency_hz * (np.arange(length) + 0.5) / hz
            kinds += [(window * np.cos(turn), 1.0), (window * np.sin(turn), 1.0)]
        mean = s.i[: count * length].reshape(count, length).mean(axis=1) / self.rated_a
        y, rows, where = [], [], []
        for weights, ripple in kinds:
            averaged = np.einsum("ctn,t->cn", cut, weights)
            edges = np.concatenate([[0.0], weights, [0.0]])
            for part, henry in ((averaged.real, self.henry[0]), (averaged.imag, self.henry[1])):
                own = self.ohm * 0.5 * (edges[1:] + edges[:-1]) - henry * np.diff(edges) * hz
                noise = self.recording.noise_a * float(np.sqrt(own @ own))
                y.append(part[:, 0] / noise)
                rows.append(part[:, 1:] / noise)
                where.append(np.stack([mean.real, mean.imag, np.full(count, ripple)], axis=1))
        return np.concatenate(y), np.concatenate(rows), np.concatenate(where)

    def _effects(self, s: Segment, heat_j: float) -> Iterator[tuple[Column, Any]]:
        """Each effect's voltage for a size of one, at the middle of each sample, shape (samples - 1,)."""
        hz, turn, rated = self.recording.hz, np.exp(1j * s.angle_rad), self.rated_a
        middle, volts = 0.5 * (s.i[1:] + s.i[:-1]), s.v[:-1]
        phases = np.real(PHASES * middle * turn)
        hess_dd, hess_dq, hess_qq = (self._polynomials(s.i, *o) @ self._energy for o in ((2, 0), (1, 1), (0, 2)))
        psi = self.flux_terms(s.i) @ self._energy
        psi = psi - self.flux_terms(np.zeros(1)) @ self._energy + (self.recording.motor.get("pm_flux_wb") or 0.0)

        def legs(loss: Any) -> Any:
            return 2 / 3 * np.sum(np.conj(PHASES) * loss, axis=0) / turn

        def inductance(x: Any) -> Any:
            return (hess_dd * x.real + hess_dq * x.imag + 1j * (hess_dq * x.real + hess_qq * x.imag)) / self.scale_a

        def reading(error: Any) -> Any:
            """Of currents that are read too large by this much."""
            return -self.ohm * 0.5 * (error[1:] + error[:-1]) - np.diff(inductance(error)) * hz

        def sensors(a: Any, b: Any) -> Any:
            return (a + 1j * (a + 2 * b) / np.sqrt(3)) / turn

        one, zero = np.ones(len(s.i)), np.zeros(len(s.i))
        at_a, at_b, _ = np.real(PHASES * s.i * turn)
        level = np.ones((3, 1)) * np.ones(len(middle))
        yield Column("dead_time", "V", 0.01 * 500), s.pwm_ratio * legs(np.tanh(phases / (0.03 * rated)))
        yield Column("device_drop", "V", 1.0), legs(np.tanh(phases / (0.01 * rated)))
        yield Column("voltage_bias", "V", 0.1), legs(level * [[1], [0], [-1]])
        yield Column("voltage_bias", "V", 0.1, False), legs(level * [[0], [1], [-1]])
        yield Column("phase_resistance_imbalance", "ohm", 0.02 * self.ohm), legs(phases * [[1], [0], [0]])
        yield Column("phase_resistance_imbalance", "ohm", 0.02 * self.ohm, False), legs(phases * [[0], [1], [0]])
        power = 1.5 * np.real(volts * np.conj(middle))
        yield Column("bus_sag", "1/W", 0.005 / (1.5 * self.ohm * rated**2)), volts * power
        before = np.concatenate([volts[:1], volts[:-1]])
        yield Column("voltage_delay", "s", 1e-5), (volts - before) * hz
        yield Column("current_filter", "s", 1e-5), reading(-np.gradient(s.i) * hz)
        yield Column("current_gain_mismatch", "1", 0.01), reading(sensors(0.5 * at_a, -0.5 * at_b))
        yield Column("current_offset", "A", 0.01 * rated), reading(sensors(one, zero))
        yield Column("current_offset", "A", 0.01 * rated, False), reading(sensors(zero, one))
        yield Column("current_nonlinearity", "1/A^2", 0.005 / rated**2), reading(sensors(at_a**3, at_b**3))
        induced = s.v - self.ohm * s.i
        siemens = 0.1 / (2 * np.pi * 500 * self.henry[1])
        yield Column("eddy_currents", "ohm", siemens, inverse=True), reading(induced)
        yield Column("hysteresis", "A", 0.01 * rated), reading(_stop(s.i, 0.05 * rated))
        yield Column("rotor_misalignment", "rad", 0.03), np.diff(1j * psi - inductance(1j * s.i)) * hz
        torque = 1.5 * float(self.recording.motor["pole_pairs"]) * np.imag(np.conj(psi) * s.i)
        rated_nm = 1.5 * float(self.recording.motor["pole_pairs"]) * np.abs(psi).max() * rated
        yield (
            Column("brake_compliance", "rad/Nm", 0.01 / rated_nm),
            np.diff(torque * (1j * psi - inductance(1j * s.i))) * hz,
        )
        loss = 1.5 * self.ohm * np.abs(middle) ** 2
        warm = heat_j * np.exp(-np.arange(len(middle)) / hz / HEATING_S) / HEATING_S + _low_pass(
            loss, HEATING_S * hz, 0.0
        )
        yield Column("winding_heating", "1/W", 0.003), self.ohm * middle * warm
        yield (
            Column("skin_effect", "ohm", 0.1 * self.ohm),
            middle - _low_pass(middle, hz / (2 * np.pi * SKIN_HZ), middle[0]),
        )
        shift = (heat_j + np.concatenate([[0.0], np.cumsum(loss) / hz])) / max(1.5 * self.ohm * rated**2, 1e-12) / 20.0
        yield Column("magnet_heating", "Wb", 0.01 * np.abs(psi).max(), False), np.diff(inductance(shift + 0j)) * hz
        mean_h = 0.5 * (self.henry[0] + self.henry[1])
        yield Column("slot_harmonics", "1", 0.02, False), mean_h * np.diff(s.i.imag + 1j * s.i.real) * hz

    def fit(self, kept: Any) -> Fit:
        """Least squares of the base and these columns."""
        design = np.concatenate([self.base, self.effects[:, kept]], axis=1)
        scale = np.sqrt(np.mean(design**2, axis=0)) + 1e-300
        left, values, right = np.linalg.svd(design / scale, full_matrices=False)
        used = values > 1e-9 * values[0]
        solved = (right[used].T @ ((left[:, used].T @ self.y) / values[used])) / scale
        rest = self.y - design @ solved
        chi2 = float(rest @ rest) / (len(self.y) - int(used.sum()))
        covariance = (right[used].T / values[used] ** 2) @ right[used] / np.outer(scale, scale) * max(chi2, 1.0)
        return Fit(list(map(int, kept)), solved, covariance, chi2)

    def projected(self) -> tuple[Any, Any]:
        """y and the columns without what the base follows, each column in units of its typical size."""
        basis = np.linalg.qr(self.base / (np.sqrt(np.mean(self.base**2, axis=0)) + 1e-300))[0]
        columns = self.effects * [column.typical for column in self.columns]
        return self.y - basis @ (basis.T @ self.y), columns - basis @ (basis.T @ columns)

    def allowed(self, entry: dict[str, Any]) -> Any:
        """Columns of the names that an answer may use."""
        return np.array([k for k, column in enumerate(self.columns) if column.name not in entry["without"]])


@dataclass
class Fit:
    """Coefficients of base and kept columns, their covariance, and chi2 per degree of freedom."""

    kept: list[int]
    solved: Any
    covariance: Any
    chi2: float


def answer_of(problem: Problem, kept: Any, entry: dict[str, Any]) -> dict[str, Any]:
    """The answer of a search that keeps these columns: refitted by least squares, the largest one first."""
    bare, fit = problem.fit([]), problem.fit(kept)
    start = len(fit.solved) - len(fit.kept)
    named: dict[str, dict[str, Any]] = {}
    weight: dict[str, float] = {}
    for n, k in enumerate(fit.kept):
        column, value = problem.columns[k], float(fit.solved[start + n])
        std = float(np.sqrt(fit.covariance[start + n, start + n]))
        share = float(np.sum((problem.effects[:, k] * value) ** 2))
        weight[column.name] = weight.get(column.name, 0.0) + share
        entry_of = named.setdefault(column.name, {"name": column.name})
        if column.reported and not (column.inverse and abs(value) < 1.96 * std):
            ends = sorted((1 / e if column.inverse else e) for e in (value - 1.96 * std, value + 1.96 * std))
            size = 1 / value if column.inverse else value
            entry_of |= {"size": size, "unit": column.unit, "low": ends[0], "high": ends[1]}
    left = np.sqrt(max(fit.chi2 - 1.0, 0.0) / max(bare.chi2 - 1.0, 1e-12))
    gone = fit.chi2 < EXPLAINED_CHI2 or left < EXPLAINED_PART
    names = sorted(named.values(), key=lambda one: -weight[one["name"]])
    return {
        "id": entry["id"],
        "verdict": ("explained" if names else "clean") if gone else "unknown",
        "names": names,
        "usable": bool(gone),
        **_base_of(problem, fit, entry),
    }


def _base_of(problem: Problem, fit: Fit, entry: dict[str, Any]) -> dict[str, Any]:
    ohm, std = float(fit.solved[0]), float(np.sqrt(fit.covariance[0, 0]))
    points = np.array([complex(*point) for point in entry["points_a"]])
    terms = problem.flux_terms(points) - problem.flux_terms(np.zeros(1, complex))
    count = terms.shape[1]
    psi = terms @ fit.solved[1 : 1 + count]
    block = fit.covariance[1 : 1 + count, 1 : 1 + count]
    stds = [np.sqrt(np.maximum(np.einsum("kn,nm,km->k", t, block, t), 0.0)) for t in (terms.real, terms.imag)]
    return {
        "resistance_ohm": {"value": ohm, "low": ohm - 1.96 * std, "high": ohm + 1.96 * std},
        "flux_wb": [[float(x.real), float(x.imag)] for x in psi],
        "flux_std_wb": [[float(d), float(q)] for d, q in zip(*stds, strict=True)],
    }


def _stop(x: Any, radius: float) -> Any:
    """A vector stop operator: what an element holds that yields at this radius, in units of it."""
    held, out = 0j, np.empty(len(x), complex)
    for k, change in enumerate(np.diff(x, prepend=x[0])):
        held += change
        size = abs(held)
        if size > radius:
            held *= radius / size
        out[k] = held / radius
    return out


def _low_pass(x: Any, samples: float, start: Any) -> Any:
    """A lag of first order from a given start."""
    fade = float(np.exp(-1.0 / samples))
    return lfilter([1 - fade], [1, -fade], x, zi=[fade * start])[0]


def main(search: Callable[[Problem, dict[str, Any]], dict[str, Any]], about: str) -> None:
    """Answer the recordings of a set that have no answer yet."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("set", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", action="append", default=[])
    wanted = parser.parse_args()
    lines = wanted.out.read_text(encoding="utf-8").splitlines() if wanted.out.exists() else []
    done = {json.loads(line)["id"] for line in lines}
    for entry in json.loads((wanted.set / "benchmark.json").read_text(encoding="utf-8"))["recordings"]:
        if entry["id"] in done or (wanted.only and entry["id"] not in wanted.only):
            continue
        start = time.perf_counter()
        found = search(Problem(read(wanted.set / "recordings" / entry["id"])), entry)
        found["seconds"] = round(time.perf_counter() - start, 2)
        with wanted.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(found) + "\n")
        print(found["id"], found["verdict"], *(name["name"] for name in found["names"]), flush=True)
