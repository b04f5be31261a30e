"""What a commissioning shows: turns the messages of a run into entries, one handler a kind of message."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from itertools import cycle
from typing import Any

import numpy as np
import rerun as rr

from orchestrator.formatting.colours import (
    AT_REST,
    COMPUTING,
    D_AXIS,
    ENDED_BADLY,
    ENDED_WELL,
    ENERGISED,
    GUIDE,
    MEASURED_ON_SCREEN,
    MODEL,
    Q_AXIS,
    packed_all,
)
from orchestrator.formatting.events import describe
from orchestrator.formatting.names import plain
from orchestrator.formatting.profiles import flux_at_zero
from orchestrator.formatting.quantities import vector
from orchestrator.formatting.results import USABILITY_WORDS
from orchestrator.formatting.sentences import shown
from orchestrator.stages import installed_stages
from plugins.streams._ripple import FluxTree, RippleFit, fit_ripple
from plugins.streams.rerun._axes import Chart, dotted, plane, reach
from plugins.streams.rerun._clock import Clock
from plugins.streams.rerun._detail import DETAIL
from plugins.streams.rerun._maps import (
    CHECKS,
    FluxBox,
    check_entries,
    flux_height,
    inductance_entries,
    reach_of,
)
from plugins.streams.rerun._status import Status
from plugins.streams.rerun._tape import ALWAYS, Entry, When, entry, properties, scalars, titled
from plugins.streams.rerun._waveforms import Thinner
from plugins.streams.rerun._words import page, resistance_page, trust_page
from protocols import (
    FluxMapEstimate,
    LockChecked,
    MapEstimated,
    Message,
    Note,
    OperatorAnswered,
    OperatorAsked,
    PointDone,
    PointStarted,
    ResistanceEstimate,
    ResistanceEstimated,
    RunEnded,
    RunStarted,
    SamplesCaptured,
    SegmentStage,
    StagesAppended,
    StageStarted,
    StageSufficed,
    StateChanged,
)

_LEVELS = {"good": "INFO", "info": "INFO", "warning": "WARN", "bad": "ERROR"}


class Commissioning:
    """The pictures of one run as it goes.

    Parameters
    ----------
    every_s : float
        Least time between two pictures of a ripple: a simulated drive measures faster than anybody looks.
    wall_s : callable
        The time that this is by; where nobody waits for the pictures, it may stand still.
    """

    def __init__(self, every_s: float = 0.25, wall_s: Callable[[], float] = time.monotonic) -> None:
        self._wall = wall_s
        self._clock = Clock(wall_s)
        self._every_s = every_s
        self._ripple_drawn_at = -math.inf
        self._thinner = Thinner(wall_s)
        self._status = Status()
        self._tree = FluxTree()
        self._box: FluxBox | None = None
        self._limits: tuple[float, float] | None = None
        self._reach_a = 1.0  # until the limits are known
        self._resistance_ohm = 0.0
        self._resistance_until_s: float | None = None
        self._resistances_ohm: list[float] = []
        self._achieved: list[tuple[float, float]] = []
        self._achieved_shown = 0
        self._maps: dict[str, FluxMapEstimate] = {}
        self._lock: LockChecked | None = None
        self._latest: SamplesCaptured | None = None
        self._shown_map: str | None = None
        self._handlers: dict[type, Callable[[Any], list[Entry]]] = {
            RunStarted: self._run_started,
            StateChanged: self._state_changed,
            StageStarted: self._stage_started,
            PointStarted: self._point_started,
            PointDone: self._point_done,
            SamplesCaptured: self._samples,
            OperatorAsked: self._logged,
            OperatorAnswered: self._logged,
            LockChecked: self._lock_checked,
            ResistanceEstimated: self._resistance,
            MapEstimated: self._map,
            StagesAppended: self._logged,
            StageSufficed: self._logged,
            Note: self._logged,
            RunEnded: self._run_ended,
        }

    @property
    def when(self) -> When:
        """Now, on the experiment's timeline."""
        return When(experiment_s=self._clock.now())

    @property
    def resistance_span_ohm(self) -> tuple[float, float] | None:
        """What estimates and readings of R_s went through, and a fifth of that beside it; None before the first."""
        if not self._resistances_ohm:
            return None
        low, high = min(self._resistances_ohm), max(self._resistances_ohm)
        beside = 0.2 * (high - low) or 0.05 * high
        return low - beside, high + beside

    @property
    def waveform_rows(self) -> int:
        """Rows of thinned waveforms that wait to be given away."""
        return self._thinner.rows

    def furniture(self) -> list[Entry]:
        """What stands from the beginning: colours, names, axes."""
        colours, values = zip(*_state_colours(), strict=True)
        styles = rr.StateConfiguration(values=values, labels=[plain(v) for v in values], colors=packed_all(colours))
        out = [entry("state/machine", ALWAYS, styles), *CHECKS.furniture(y_ticks=False), *self._planes()]
        for name, unit in (("current", "A"), ("voltage", "V")):
            symbol = name[0] if name == "voltage" else "i"
            names = [f"{symbol}_d [{unit}]", f"{symbol}_q [{unit}]"]
            out.append(_series(f"drive/{name}", names, [D_AXIS, Q_AXIS]))
            out.append(_series(f"drive/limit/{name}", [f"limit [{unit}]", f"limit [{unit}]"], [GUIDE, GUIDE]))
        names = ["L_dd [mH]", "L_dq [mH]", "L_qq [mH]"]
        out.append(_dots("point/inductance", names, [D_AXIS, GUIDE, Q_AXIS]))
        out.append(_dots("point/off_target", ["off target, d [mA]", "off target, q [mA]"], [D_AXIS, Q_AXIS]))
        names = ["reading [Ω]", "reading − σ", "reading + σ"]
        out.append(_dots("resistance/readings", names, [MEASURED_ON_SCREEN, GUIDE, GUIDE]))
        out.append(_series("resistance/estimate", ["estimate [Ω]", "95 % low", "95 % high"], [MODEL, GUIDE, GUIDE]))
        return out

    def take(self, message: Message) -> list[Entry]:
        """The entries that a message makes; none for what is not a commissioning's."""
        handler = self._handlers.get(type(message))
        return [] if handler is None else handler(message)

    def waveforms(self) -> list[Entry]:
        """The thinned waveforms collected so far."""
        return self._thinner.give(self._limits)

    def _planes(self) -> list[Entry]:
        return plane("plane/amperes", self._reach_a, None if self._limits is None else self._limits[0])

    def _logged(self, message: Message) -> list[Entry]:
        text = describe(message)
        return [] if text is None else [entry("log", self.when, rr.TextLog(shown(text.line), level=_LEVELS[text.mood]))]

    def _page(self) -> Entry:
        return page("status", self.when, self._status.page())

    def _run_started(self, message: RunStarted) -> list[Entry]:
        self._status.started = message
        self._limits = (message.limits.current_a, message.limits.voltage_v)
        self._reach_a = 1.05 * message.limits.current_a
        self._resistance_ohm = message.motor.stator_resistance_ohm or 0.0
        facts = {k: v for k, v in message.motor.model_dump().items() if v is not None}
        return [
            titled(message.name),
            properties("run", {"name": message.name, "drive": message.drive, "points": message.points}),
            properties("motor", facts),
            *self._planes(),
            *self._logged(message),
            self._page(),
        ]

    def _state_changed(self, message: StateChanged) -> list[Entry]:
        self._status.state = message.target
        out = [*self.waveforms(), entry("state/machine", self.when, rr.StateChange(state=message.target)), self._page()]
        return out + (self._logged(message) if message.reason else [])

    def _stage_started(self, message: StageStarted) -> list[Entry]:
        self._status.stage = message
        return [*self._logged(message), self._page()]

    def _point_started(self, message: PointStarted) -> list[Entry]:
        self._latest = None
        self._status.point = message
        out: list[Entry] = []
        if message.target_d_a is not None and message.target_q_a is not None:
            at = np.array([[message.target_d_a, message.target_q_a]])
            out.append(dotted("plane/amperes/target", self.when, at, GUIDE, -9.0))
        return out

    def _samples(self, message: SamplesCaptured) -> list[Entry]:
        capture = message.capture
        self._clock.seen(capture.start_s + len(capture) / capture.sampling_frequency_hz)
        self._thinner.take(capture, message.rotor_angle_rad)
        if len(capture):
            self._latest = message
        return []

    def _point_done(self, message: PointDone) -> list[Entry]:
        self._status.done = message
        self._clock.seen(max(message.segment.start_s, self._clock.now()))
        achieved = (message.achieved_d_a, message.achieved_q_a)
        out = [dotted("plane/amperes/latest", self.when, np.array([achieved]), Q_AXIS, -5.0), self._page()]
        if message.segment.stage in (SegmentStage.INJECTION, SegmentStage.RESISTANCE):
            self._achieved.append(achieved)
            out += self._off_target(message)
            if len(self._achieved) > 1.05 * self._achieved_shown:
                out += self._reached()
        if message.segment.stage is SegmentStage.INJECTION:
            out += self._ripple(message)
        return out

    def limit_lines(self) -> list[Entry]:
        """The limits up to now."""
        if self._limits is None:
            return []
        amperes, volts = self._limits
        lines = (("current", amperes), ("voltage", volts))
        return [entry(f"drive/limit/{name}", self.when, rr.Scalars([v, -v])) for name, v in lines]

    def _reached(self) -> list[Entry]:
        self._achieved_shown = len(self._achieved)
        at = np.array(self._achieved)
        return [dotted("plane/amperes/achieved", self.when, at, D_AXIS, -3.0)] if len(at) else []

    def _off_target(self, message: PointDone) -> list[Entry]:
        started = self._status.point
        if started is None or started.id != message.id or started.target_d_a is None or started.target_q_a is None:
            return []
        off_ma = 1e3 * (message.achieved_d_a - started.target_d_a), 1e3 * (message.achieved_q_a - started.target_q_a)
        return [entry("point/off_target", self.when, rr.Scalars(off_ma))]

    def _ripple(self, message: PointDone) -> list[Entry]:
        latest = self._latest
        if latest is None or latest.segment != message.segment.id:
            return []
        fit = fit_ripple(latest.capture, latest.rotor_angle_rad, self._resistance_ohm)
        if fit is None:
            return []
        frequency = message.segment.settings.get("frequency_hz")
        period_s = (
            1.0 / frequency if isinstance(frequency, int | float) and frequency > 0 else float(fit.time_s[-1]) / 8
        )
        l_h = 1e3 * fit.inductance_h
        out = [entry("point/inductance", self.when, rr.Scalars([l_h[0, 0], l_h[0, 1], l_h[1, 1]]))]
        if self._wall() - self._ripple_drawn_at >= self._every_s:
            self._ripple_drawn_at = self._wall()
            out += _ripple_chart(self.when, fit, DETAIL.ripple_periods * period_s)
        self._tree.add(fit.mean_a, fit.inductance_h)
        if self._box is None:
            self._box = FluxBox(self._reach_a, 0.6 * self._reach_a * float(fit.inductance_h.trace()) / 2)
            out += self._box.furniture(self.when)
        if len(self._tree) < 30 or len(self._tree) % 20 == 0:
            out += self._box.points(self.when, *self._tree.points())
        return out

    def _lock_checked(self, message: LockChecked) -> list[Entry]:
        self._lock = self._status.lock = message
        return [*self._logged(message), page("trust", self.when, trust_page(self._maps, self._lock))]

    def _resistance(self, message: ResistanceEstimated) -> list[Entry]:
        estimate = message.estimate
        self._resistance_ohm = estimate.value_ohm
        self._status.resistance = estimate
        out = [page("resistance/page", self.when, resistance_page(estimate)), self._page()]
        facts = {"value_ohm": estimate.value_ohm, "low": estimate.low, "high": estimate.high}
        self._resistances_ohm += [estimate.value_ohm, *(r.value_ohm for r in estimate.readings)]
        out.append(properties("resistance", facts))
        first_s, last_s = 0.0, self._clock.now()
        if estimate.readings:
            at = np.array([r.start_s for r in estimate.readings])
            order = np.argsort(at, kind="stable")
            value = np.array([r.value_ohm for r in estimate.readings])[order]
            std = np.array([r.std_ohm for r in estimate.readings])[order]
            out.append(scalars("resistance/readings", at[order], np.stack([value, value - std, value + std], axis=1)))
            first_s, last_s = float(at.min()), max(float(at.max()), last_s)
        return [*out, *self._resistance_line(estimate, first_s, last_s)]

    def _resistance_line(self, estimate: ResistanceEstimate, first_s: float, last_s: float) -> list[Entry]:
        """The estimate as a level up to now, from where the one before it ended; no line joins the two."""
        path = "resistance/estimate"
        gap: list[Entry] = []
        if self._resistance_until_s is not None:
            first_s = self._resistance_until_s + 0.1
            last_s = max(last_s, first_s + 1.0)
            gap = [entry(path, When(experiment_s=first_s - 0.05), rr.Clear(recursive=False))]
        self._resistance_until_s = last_s
        level = np.array([[estimate.value_ohm, estimate.low, estimate.high]] * 2)
        return [*gap, scalars(path, np.array([first_s, last_s]), level)]

    def _map(self, message: MapEstimated) -> list[Entry]:
        estimate = message.estimate
        self._maps[estimate.map.method] = estimate
        out = self._reached() + self._show_map(estimate)
        out += check_entries(self.when, self._maps)
        return [*out, page("trust", self.when, trust_page(self._maps, self._lock))]

    def _show_map(self, estimate: FluxMapEstimate) -> list[Entry]:
        self._shown_map = self._status.map_method = estimate.map.method
        # The limits may lie far beyond what was measured: the box is the map's.
        self._box = FluxBox(1.05 * reach_of(estimate.map), 1.05 * flux_height(estimate.map))
        out = self._box.furniture(self.when) + self._box.surfaces(self.when, estimate.map)
        psi_dq = estimate.points.psi_dq - np.array(list(flux_at_zero(estimate.map).values()))
        out += self._box.points(self.when, estimate.points.i_dq, psi_dq)
        return [*out, *inductance_entries(self.when, estimate.map), self._page()]

    def _run_ended(self, message: RunEnded) -> list[Entry]:
        self._status.ended = message
        facts = {"outcome": message.outcome, "reason": message.reason}
        out = [*self.waveforms(), *self._reached()]
        if message.estimates is not None:
            method = message.estimates.method
            facts |= {"method": str(method), "usable": USABILITY_WORDS[message.estimates.usability]}
            if method in self._maps and method != self._shown_map:
                out += self._show_map(self._maps[method])
        return [*out, properties("outcome", facts), *self._logged(message), self._page()]


def _ripple_chart(when: When, fit: RippleFit, seconds: float) -> list[Entry]:
    shown = fit.time_s <= seconds
    time_ms = 1e3 * fit.time_s[shown]
    out: list[Entry] = []
    for axis, name in enumerate("dq"):
        measured, fitted = 1e3 * fit.measured_a[axis, shown], 1e3 * fit.fitted_a[axis, shown]
        chart = Chart(
            f"ripple/{name}", (0.0, float(time_ms[-1])), reach(measured), "time [ms]", f"ripple of i_{name} [mA]"
        )
        title = f"at {vector(fit.mean_a[0], fit.mean_a[1])}"
        out += chart.furniture(when, title)
        out.append(chart.points("measured", when, time_ms, measured, MEASURED_ON_SCREEN, -2.0))
        out.append(chart.line("fitted", when, time_ms, fitted, MODEL))
        out.append(chart.legend(when, [("measured", MEASURED_ON_SCREEN), ("fitted", MODEL)]))
    return out


def _state_colours() -> Iterator[tuple[str, str]]:
    """Colour and name of every state of a run; two tints in turn tell neighbours among the energised ones apart."""
    yield from ((AT_REST, state) for state in ("idle", "connecting", "waiting_for_operator", "paused", "stopping"))
    stages = installed_stages()
    yield from ((COMPUTING, name) for name in dict.fromkeys(state.name for s in stages for state in s.working))
    measuring = dict.fromkeys(stage.measuring.name for stage in stages if stage.measuring is not None)
    yield from zip(cycle(ENERGISED), measuring, strict=False)
    yield (ENDED_WELL, "finished")
    yield from ((ENDED_BADLY, state) for state in ("faulted", "aborted"))


def _series(path: str, names: list[str], colours: list[str]) -> Entry:
    lines = rr.SeriesLines(
        names=names, colors=packed_all(colours), widths=[1.2] * len(names), aggregation_policy="MinMax"
    )
    return entry(path, ALWAYS, lines)


def _dots(path: str, names: list[str], colours: list[str]) -> Entry:
    return entry(
        path, ALWAYS, rr.SeriesPoints(names=names, colors=packed_all(colours), marker_sizes=[2.5] * len(names))
    )
