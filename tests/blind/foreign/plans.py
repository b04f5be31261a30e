"""What benches measure: plans as sequences of parts from a grammar, in the stages and settings that a logger writes.

    plan      = [gates off] [holds] {sweeps | ramps with sines | binary steps | injection} [anchor] , with options
    injection = rotating square | sines | chirp | several sines | binary steps, at points of the plane
    options   = gaps, drifting set-points, second angle, second PWM frequency, second amplitude

A plan knows the nameplate alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tests.blind.foreign.iron import Array
from tests.blind.magnetics import Machine

Rng = np.random.Generator
SLOW_HZ, FAST_HZ = 4.0, 25.0
"""Bandwidth of the current control under an injected wave, and without one."""
SECOND_ANGLE_RAD = np.pi / 3


@dataclass(frozen=True)
class Segment:
    """One segment: where it settles first, and what is captured then.

    Attributes
    ----------
    path_a : array (samples, 2)
        Set-points on d and q.
    wave_v : array (samples, 2) or None
        Voltages on top of the control's, which is slow then.
    open_loop : bool
        Whether the mean voltage of the settling is held instead of the control.
    before_s : float
        Time that passes uncaptured before, at no current.
    gap_s : tuple of float or None
        Stretch [s] of the segment that is not captured: two segments come of it.
    """

    stage: str
    settings: dict[str, Any]
    path_a: Array
    wave_v: Array | None = None
    open_loop: bool = False
    pwm_ratio: float = 1.0
    angle_rad: float = 0.0
    before_s: float = 0.0
    gap_s: tuple[float, float] | None = None


@dataclass(frozen=True)
class Bench:
    """What parts are made for: nameplate, range of currents, and a generator for what is random in them."""

    plate: Machine
    span_d: tuple[float, float]
    rng: Rng
    drift: float = 0.0
    """Set-points wander by this part of the largest current in a segment."""
    labels: bool = True
    """Whether the waveform of an injection is in its settings."""
    thrift: float = 1.0
    """Seconds are multiplied by it."""

    def samples(self, seconds: float) -> int:
        return round(self.plate.sampling_hz * seconds * self.thrift)

    def point(self, d: float | Array, q: float | Array) -> Array:
        """Currents [A], the axes last; d goes from -1 to 1 over the span."""
        low, high = self.span_d
        d, q = np.broadcast_arrays(d, q)
        return np.stack([np.where(d < 0, -low, high) * d, q], axis=-1) * self.plate.top_a

    def path(self, point: Array, count: int) -> Array:
        """A held set-point, or one that drifts."""
        ends = self.drift * self.plate.top_a * self.rng.uniform(-1.0, 1.0, (2, 2))
        return np.linspace(point - ends[0], point + ends[1], count)

    def amplitude_v(self, hz: float, swing: float) -> Array:
        """Volts on d and q that swing the current by this part of the rated one at a frequency.

        The iron of an axis with many times the other's inductance saturates: no more than double is reckoned with.
        """
        plate = self.plate
        rated_a = np.sqrt(2.0) * plate.rated_current_rms_a
        least = min(plate.l_d_h, plate.l_q_h)
        return np.asarray(2 * np.pi * hz * swing * rated_a * np.minimum([plate.l_d_h, plate.l_q_h], 2 * least))


GRID = [(d, q) for d in (-1.0, -0.5, 0.0, 0.5, 1.0) for q in (-1.0, -0.5, 0.0, 0.5, 1.0)]
COARSE = [(d, q) for d in (-0.9, 0.0, 0.9) for q in (-0.9, -0.3, 0.3, 0.9)]


def gates_off(b: Bench) -> Iterator[Segment]:
    """The sensors alone."""
    yield Segment("gates_off", {}, np.zeros((b.samples(0.3), 2)))


def hold(b: Bench, d: float, q: float, ratio: float = 1.0, **more: Any) -> Segment:
    """A direct current."""
    point = b.point(d, q)
    settings = {"current_d_a": float(point[0]), "current_q_a": float(point[1]), **more}
    if ratio != 1.0:
        settings["pwm_frequency_hz"] = ratio * b.plate.sampling_hz
    return Segment("resistance", settings, b.path(point, b.samples(0.2)), pwm_ratio=ratio)


def holds(b: Bench, count: int = 14, ratio: float = 1.0) -> Iterator[Segment]:
    """Direct currents, small ones among them."""
    sizes = [0.4, -0.4, 1.0, -1.0, 0.08, -0.08, 0.15, -0.15, 0.7, -0.7, 0.03, -0.03]
    points = [(s, 0.0) for s in sizes[:6]] + [(0.0, 1.0), (0.0, -1.0)] + [(s, 0.0) for s in sizes[6:]]
    points += [(0.0, 0.3), (0.0, -0.3), (0.0, 0.08), (-0.5, 0.6)]
    yield from (hold(b, d, q, ratio) for d, q in points[:count])


def anchor(b: Bench) -> Iterator[Segment]:
    """A point that is measured first and last."""
    yield hold(b, -0.67, 0.0, anchor=True)


def sweeps(b: Bench, held: Sequence[float] = (-1.0, -0.5, 0.0, 0.5, 1.0), period_s: float = 0.9) -> Iterator[Segment]:
    """Trapezoids on q and on d with the other current held."""
    count = b.samples(period_s)
    shape = np.interp(np.arange(count) / count, [0, 0.125, 0.375, 0.625, 0.875, 1.0], [0, 1, 1, -1, -1, 0])
    for level in held:
        for axis in ("q", "d"):
            waves = b.point(level, shape) if axis == "q" else b.point(shape, level)
            other = float(waves[0, 0] if axis == "q" else waves[0, 1])
            settings = {
                "swept_axis": axis, "held_a": other, "amplitude_a": float(np.abs(waves[:, int(axis == "q")]).max()),
                "period_s": count / b.plate.sampling_hz, "periods": 1,
            }  # fmt: skip
            yield Segment("classical", settings, waves)


def ramps(b: Bench, count: int = 7, seconds: float = 1.6) -> Iterator[Segment]:
    """Slow straight paths through the plane with two sines on top, as a bench engineer draws them."""
    angles = np.pi * (np.arange(count) + b.rng.uniform(0, 1)) / count
    for angle in angles:
        rows = b.samples(seconds)
        way = np.interp(np.arange(rows) / rows, [0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0])
        path = b.point(0.9 * np.cos(angle) * way, 0.9 * np.sin(angle) * way)
        t = np.arange(rows) / b.plate.sampling_hz
        hz = b.rng.uniform(60.0, 140.0, 2)
        wave = b.amplitude_v(float(hz[0]), 0.08) * np.sin(2 * np.pi * t[:, None] * hz + [0.0, 1.0])
        yield Segment("classical", {}, path, wave)


def _binary(b: Bench, rows: int, clock_s: float, swing: float) -> Array:
    """Random signs, held for whole clock periods."""
    clock = max(1, round(clock_s * b.plate.sampling_hz))
    signs = b.rng.choice([-1.0, 1.0], (rows // clock + 1, 2)).repeat(clock, axis=0)[:rows]
    return np.asarray(signs * b.amplitude_v(0.08 / clock_s, swing))


def binary_steps(b: Bench, count: int = 4, seconds: float = 2.2) -> Iterator[Segment]:
    """Random binary voltages while the set-point wanders round the plane."""
    for _ in range(count):
        rows = b.samples(seconds)
        corners = np.concatenate([[[0, 0]], b.rng.uniform(-0.8, 0.8, (5, 2)), [[0, 0]]])
        at = np.linspace(0, len(corners) - 1, rows)
        path = b.point(*(np.interp(at, np.arange(len(corners)), corners[:, n]) for n in range(2)))
        yield Segment("classical", {}, path, _binary(b, rows, float(b.rng.uniform(0.6e-3, 2e-3)), 0.3))


Wave = Callable[[Bench, int], tuple[Array, dict[str, Any]]]


def square(swing: float = 0.16, rotation_hz: float = 2.5, ratio: float = 1.0) -> Wave:
    """The usual square wave that rotates."""

    def wave(b: Bench, rows: int) -> tuple[Array, dict[str, Any]]:
        t, hz = np.arange(rows) / b.plate.sampling_hz, ratio * b.plate.injection_hz
        volts = float(f"{b.amplitude_v(hz, swing).min():.2g}")
        sign = np.where(np.floor(2 * hz * t + 1e-6) % 2 == 0, 1.0, -1.0)
        angle = 2 * np.pi * rotation_hz * t
        settings = {"amplitude_v": volts, "frequency_hz": hz, "rotation_hz": rotation_hz, "waveform": "square"}
        return volts * sign[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), settings

    return wave


def sine(ratio: float = 1.0, swing: float = 0.15) -> Wave:
    """A sine along d, then along q."""

    def wave(b: Bench, rows: int) -> tuple[Array, dict[str, Any]]:
        t, hz = np.arange(rows) / b.plate.sampling_hz, ratio * b.plate.injection_hz
        volts = float(f"{b.amplitude_v(hz, swing).min():.2g}")
        axis = np.arange(2) == (np.arange(rows) >= rows // 2)[:, None]
        settings = {"amplitude_v": volts, "frequency_hz": hz, "rotation_hz": 0.0, "waveform": "sine"}
        return volts * np.cos(2 * np.pi * hz * t)[:, None] * axis, settings

    return wave


def chirp(b: Bench, rows: int) -> tuple[Array, dict[str, Any]]:
    """A sine that goes from 20 Hz to the injection's frequency, on d forwards and on q backwards."""
    x = np.arange(rows) / rows
    hz = 20.0 * (b.plate.injection_hz / 20.0) ** x
    phase = 2 * np.pi * np.cumsum(hz) / b.plate.sampling_hz
    volts = np.stack([b.amplitude_v(1.0, 0.1)[n] * (hz, hz[::-1])[n] for n in range(2)], axis=1)
    return volts * np.cos(np.stack([phase, phase[::-1]], axis=1)), {}


def several_sines(b: Bench, rows: int) -> tuple[Array, dict[str, Any]]:
    """Eight frequencies with random phases, odd multiples on d and even ones on q."""
    t, wave = np.arange(rows) / b.plate.sampling_hz, np.zeros((rows, 2))
    for n, multiple in enumerate(np.unique(np.geomspace(4, b.plate.injection_hz / 5.0, 10).round())):
        hz, axis = 5.0 * multiple, n % 2
        phase = b.rng.uniform(0, 2 * np.pi)
        wave[:, axis] += b.amplitude_v(hz, 0.06)[axis] * np.sin(2 * np.pi * hz * t + phase)
    return wave, {}


def binary(b: Bench, rows: int) -> tuple[Array, dict[str, Any]]:
    """Random binary voltages about a point."""
    return _binary(b, rows, 1e-3, 0.15), {}


def injection(b: Bench, points: Sequence[tuple[float, float]], wave: Wave, seconds: float = 0.4) -> Iterator[Segment]:
    """A wave at points of the plane, on the voltage that holds the point; under slow control where that would drift."""
    for d, q in points:
        point, rows = b.point(d, q), b.samples(seconds)
        volts, settings = wave(b, rows)
        target = {"target_d_a": float(point[0]), "target_q_a": float(point[1])}
        shown = {**target, **(settings if b.labels else {})}
        yield Segment("injection", shown, b.path(point, rows), volts, open_loop=b.drift == 0.0 and wave is not binary)


def standard(b: Bench) -> Iterator[Segment]:
    """The usual campaign in short: two amplitudes, two PWM frequencies, gates off, anchors."""
    yield from gates_off(b)
    yield from anchor(b)
    yield from holds(b)
    yield from holds(b, 6, 2.0)
    yield from sweeps(b)
    yield from injection(b, GRID, square())
    yield from injection(b, GRID[::4], square(0.08))
    yield from anchor(b)


def random_binary(b: Bench) -> Iterator[Segment]:
    """Random binary voltages and little else."""
    yield from holds(b, 10)
    yield from binary_steps(b)
    yield from injection(b, [*COARSE, (0.0, 0.0)], binary, 0.5)
    yield from anchor(b)


def chirps(b: Bench) -> Iterator[Segment]:
    """Chirps at points, and trapezoids."""
    yield from gates_off(b)
    yield from holds(b, 8)
    yield from sweeps(b, (-0.8, 0.0, 0.8))
    yield from injection(b, COARSE, chirp, 0.8)


def multisine(b: Bench) -> Iterator[Segment]:
    """Several sines at once at points, and trapezoids."""
    yield from holds(b, 8)
    yield from sweeps(b, (-0.8, 0.0, 0.8))
    yield from injection(b, COARSE, several_sines, 0.8)


def one_angle(b: Bench) -> Iterator[Segment]:
    """Trapezoids and sines at one angle, one PWM frequency, one amplitude."""
    yield from gates_off(b)
    yield from holds(b, 8)
    yield from sweeps(b, (-0.9, -0.3, 0.3, 0.9), 1.2)
    yield from injection(b, COARSE, sine(), 0.4)


def thirty_seconds(b: Bench) -> Iterator[Segment]:
    """What a bench lends in half a minute, settling included."""
    short = replace(b, thrift=0.6)
    yield from gates_off(short)
    yield from holds(short, 8)
    yield from sweeps(short, (-0.9, 0.0, 0.9))
    yield from injection(short, COARSE, sine(), 0.5)


def slow_ramps(b: Bench) -> Iterator[Segment]:
    """Slow ramps with sines on top, sines of two frequencies and two amplitudes at points."""
    yield from anchor(b)
    yield from holds(b, 6)
    yield from ramps(b)
    yield from injection(b, COARSE[::2], sine(0.5), 0.25)
    yield from injection(b, COARSE[1::2], sine(1.0), 0.25)
    yield from injection(b, COARSE[::3], sine(1.0, 0.2), 0.25)
    yield from anchor(b)


def no_holds(b: Bench) -> Iterator[Segment]:
    """Nobody held a direct current."""
    yield from sweeps(b)
    yield from injection(b, GRID[::2], square())


def drifting(b: Bench) -> Iterator[Segment]:
    """Set-points that wander by 6 % while a segment is captured."""
    loose = replace(b, drift=0.06)
    yield from gates_off(loose)
    yield from holds(loose, 10)
    yield from sweeps(loose, (-0.8, 0.0, 0.8))
    yield from injection(loose, GRID[::2], square())


def gaps(b: Bench) -> Iterator[Segment]:
    """The logger stops now and then within a segment, and for seconds between segments."""
    for n, segment in enumerate(no_gates(b)):
        rows = len(segment.path_a) / b.plate.sampling_hz
        if n % 5 == 2:
            segment = replace(segment, before_s=float(b.rng.uniform(1.0, 8.0)))
        if n % 3 == 1 and segment.stage != "gates_off":
            start = float(b.rng.uniform(0.3, 0.6)) * rows
            segment = replace(segment, gap_s=(start, start + float(b.rng.uniform(0.05, 0.3)) * rows))
        yield segment


def no_gates(b: Bench) -> Iterator[Segment]:
    """The usual campaign without the reading with gates off and without a second PWM frequency."""
    yield from holds(b, 12)
    yield from sweeps(b, (-0.9, 0.0, 0.9))
    yield from injection(b, GRID[::2], square())
    yield from injection(b, GRID[::6], square(0.08))


def drawn(b: Bench) -> Iterator[Segment]:
    """Parts and options drawn at random."""
    rng = b.rng
    b = replace(b, labels=bool(rng.random() < 0.6), drift=float(rng.choice([0.0, 0.0, 0.04])))
    parts: list[Iterator[Segment]] = []
    if rng.random() < 0.5:
        parts.append(gates_off(b))
    if rng.random() < 0.7:
        parts.append(holds(b, int(rng.integers(4, 14))))
    if rng.random() < 0.3:
        parts.append(holds(b, 6, 2.0))
    moving = rng.choice(["sweeps", "ramps", "binary"], 2, replace=False)
    for kind in moving:
        parts.append(
            {
                "sweeps": lambda: sweeps(b, (-0.9, 0.0, 0.9)),
                "ramps": lambda: ramps(b, 4),
                "binary": lambda: binary_steps(b, 2),
            }[str(kind)]()
        )
    waves: dict[str, Wave] = {
        "square": square(),
        "sine": sine(),
        "chirp": chirp,
        "sines": several_sines,
        "binary": binary,
    }
    for kind in rng.choice(list(waves), 2, replace=False):
        parts.append(injection(b, [COARSE[k] for k in rng.permutation(len(COARSE))[:9]], waves[str(kind)], 0.4))
    if rng.random() < 0.5:
        parts.append(anchor(b))
    turned = bool(rng.random() < 0.25)
    for n, part in enumerate(parts):
        for segment in part:
            away = turned and n >= len(parts) // 2 and segment.stage != "gates_off"
            yield replace(segment, angle_rad=SECOND_ANGLE_RAD if away else 0.0)


PLANS: dict[str, Callable[[Bench], Iterator[Segment]]] = {
    "standard": standard,
    "random_binary": random_binary,
    "chirps": chirps,
    "multisine": multisine,
    "one_angle": one_angle,
    "thirty_seconds": thirty_seconds,
    "slow_ramps": slow_ramps,
    "no_holds": no_holds,
    "drifting": drifting,
    "gaps": gaps,
    "drawn": drawn,
}
