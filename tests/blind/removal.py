"""What each hidden effect does, by the plant itself: which one is the largest, and which an engineer would want named.

The plant is run without noise, with all that is hidden and with each effect taken out in turn. What the healthy
machine's own equation misses in the one run and not in the other is the effect's; what R_s and a map would follow is
taken out of it. No fit of the diagnosis is looked at, nor any of its code used.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from tests.blind.campaign import Bench, Campaign, rows_of
from tests.blind.hidden import Case, Truth
from tests.blind.magnetics import Array, Table
from tests.blind.plant import HEALTHY

DEGREE = 8
"""Of the energy that follows: total degree of a polynomial that is even in i_q."""
WINDOW_S = 0.01
NOTHING = 1e-5
"""Of the voltage: an error of less is what sums of samples leave of none."""
HARMONICS = (1, 3)
"""Of the injection's frequency, that make the ripple."""

Kinds = Mapping[str, Array]
"""Rows by kind: holds, sweeps, means under injection, ripple; each shape (rows, columns)."""


@dataclass(frozen=True)
class Removal:
    """What goes when one effect goes.

    Attributes
    ----------
    of_error : float
        rms of what it makes over the rms of all that is hidden, largest over holds, sweeps, injection's means, ripple.
    of_excitation : float
        The same over the rms of the voltage there.
    of_flux : float
        How far a map that follows is moved by it, rms over the currents of the campaign, of the rated flux.
    """

    of_error: float
    of_excitation: float
    of_flux: float

    def is_material(self, flux: float, voltage: float) -> bool:
        """Whether it counts in an engineer's units."""
        return self.of_flux > flux or self.of_excitation > voltage


def removals(case: Case) -> dict[str, Removal]:
    """Of every hidden effect of the catalogue, by name."""
    bench = dataclasses.replace(case.bench, plant=case.bench.plant._replace(noise=0.0, quantum=0.0))
    space = _Space(bench, case.campaign)
    error, columns, volts = space.error_of(bench), space.columns, space.volts
    whole = {kind: _rms(rows) for kind, rows in _without_map(error, columns)[0].items()}
    reported = [kind for kind in whole if whole[kind] > NOTHING * volts[kind]]
    found = {}
    for truth in case.truths:
        rest = space.error_of(without(bench, truth))
        left, follows = _without_map({kind: error[kind] - rest[kind] for kind in error}, columns)
        sizes = {kind: _rms(rows) for kind, rows in left.items()}
        found[truth.name] = Removal(
            of_error=max((sizes[kind] / whole[kind] for kind in reported), default=0.0),
            of_excitation=max(sizes[kind] / volts[kind] for kind in sizes),
            of_flux=space.moved(follows[1:]),
        )
    return found


def without(bench: Bench, truth: Truth) -> Bench:
    """The bench with one effect taken out of it."""
    gone = {name: getattr(HEALTHY, name) for name in truth.changes if name not in ("substeps", "slot")}
    table = _without_slots(bench.table) if "slot" in truth.changes else bench.table
    return dataclasses.replace(bench, plant=bench.plant._replace(**gone), table=table)


def _without_slots(table: Table) -> Table:
    """A machine's map as far as it is even in i_q."""
    even = 0.5 * (table.coefficients + table.coefficients[:, ::-1])
    return Table(np.ascontiguousarray(even), table.low_a, table.step_a)


class _Space:
    """What R_s and a map can follow on one bench, in the rows in which errors are reported."""

    def __init__(self, bench: Bench, campaign: Campaign) -> None:
        self._healthy, self._campaign = bench, campaign
        self._map = _without_slots(bench.table)
        seen = list(self._captured(bench))
        self._visited = np.array([current.mean(axis=0) for _, current, _ in seen])
        self.columns = self._rows((kind, self._followed(current)) for kind, current, _ in seen)
        volts = self._rows((kind, voltage[:-1, :, None]) for kind, _, voltage in seen)
        self.volts = {kind: _rms(rows) for kind, rows in volts.items()}

    def error_of(self, bench: Bench) -> dict[str, Array]:
        """What the healthy machine's equation misses on this bench [V], by kind; shape (rows,)."""
        missed = ((kind, self._missed(current, voltage)) for kind, current, voltage in self._captured(bench))
        return {kind: rows[:, 0] for kind, rows in self._rows(missed).items()}

    def _captured(self, bench: Bench) -> Iterator[tuple[str, Array, Array]]:
        return (one for one in rows_of(bench, self._campaign) if one[0] != "gates_off")

    def _rows(self, samples: Iterable[tuple[str, Array]]) -> dict[str, Array]:
        """Of segments' samples, each with its stage, what is reported of them, by kind; shape (rows, columns)."""
        parts: dict[str, list[Array]] = {}
        for stage, values in samples:
            ripple = self._healthy.machine.injection_hz if stage == "injection" else None
            for kind, part in self._carried(values, stage, ripple):
                parts.setdefault(kind, []).append(part)
        return {kind: np.concatenate(rows) for kind, rows in parts.items()}

    def moved(self, coefficients: Array) -> float:
        """How far these numbers of a map move its flux, of the rated flux."""
        machine = self._healthy.machine
        flux = self._flux_columns(self._visited) @ coefficients
        return float(np.sqrt(np.mean(np.sum((flux - flux.mean(axis=0)) ** 2, axis=1))) / machine.rated_flux_wb)

    def _missed(self, current: Array, voltage: Array) -> Array:
        """v - R i - dpsi/dt by samples, shape (samples - 1, 2, 1), by the map without slots, which are hidden."""
        bench = self._healthy
        flux = np.array([self._map.flux(float(d), float(q)) for d, q in current])
        mean = 0.5 * (current[1:] + current[:-1])
        rise = np.diff(flux, axis=0) * bench.machine.sampling_hz
        return np.asarray(voltage[:-1] - bench.plant.resistance * mean - rise)[:, :, None]

    def _followed(self, current: Array) -> Array:
        """Columns of R_s and the map by samples, shape (samples - 1, 2, columns)."""
        mean = 0.5 * (current[1:] + current[:-1])
        rise = np.diff(self._flux_columns(current), axis=0) * self._healthy.machine.sampling_hz
        return np.concatenate([mean[:, :, None], rise], axis=2)

    def _flux_columns(self, current: Array) -> Array:
        """Gradient of each polynomial of the energy, shape (samples, 2, columns)."""
        scale = 1.4 * self._healthy.machine.top_a
        unit = np.eye(DEGREE + 1)
        at = current / scale
        value = [chebyshev.chebval(at, c) for c in unit]
        slope = [chebyshev.chebval(at, chebyshev.chebder(c)) for c in unit]
        columns = [
            np.stack([slope[m][:, 0] * value[n][:, 1], value[m][:, 0] * slope[n][:, 1]], axis=1)
            for n in range(0, DEGREE + 1, 2)
            for m in range(DEGREE + 1 - n)
            if m + n > 1
        ]
        return np.stack(columns, axis=2)

    def _carried(self, samples: Array, kind: str, ripple_hz: float | None) -> list[tuple[str, Array]]:
        """Means of windows, and the ripple in them, each shape (rows, columns)."""
        hz = self._healthy.machine.sampling_hz
        length = round(WINDOW_S * hz)
        count = len(samples) // length
        windows = samples[: count * length].reshape(count, length, 2, -1)
        parts = [(kind, windows.mean(axis=1).reshape(2 * count, -1))]
        if ripple_hz is not None:
            turns = 2j * np.pi * ripple_hz / hz * np.arange(length)
            for harmonic in HARMONICS:
                wave = np.einsum("kscn,s->kcn", windows, np.exp(-harmonic * turns)) / length
                parts += [("ripple", half.reshape(2 * count, -1)) for half in (wave.real, wave.imag)]
        return parts


def _without_map(rows: Kinds, columns: Kinds) -> tuple[dict[str, Array], Array]:
    """What is left of the rows where R_s and the map follow, and these numbers."""
    design = np.concatenate([columns[kind] for kind in rows])
    target = np.concatenate([rows[kind] for kind in rows])
    scale = np.sqrt(np.mean(design**2, axis=0))
    follows = np.linalg.lstsq(design / scale, target, rcond=1e-10)[0] / scale
    return {kind: rows[kind] - columns[kind] @ follows for kind in rows}, follows


def _rms(rows: Array) -> float:
    return float(np.sqrt(np.mean(rows**2)))
