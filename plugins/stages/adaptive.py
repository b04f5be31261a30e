"""Signal injection where it tells most: the map is fitted while it is measured, until it is known well enough."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field

from orchestrator.stages import MAX_POINTS, Scaling, given
from protocols import (
    EnergisedStage,
    Excitation,
    Injection,
    Note,
    Point,
    Positive,
    SegmentStage,
    StageContext,
    StagePoint,
    StageRun,
    StageState,
)

if TYPE_CHECKING:
    from orchestrator.analysis import Candidate, KnownMap

CHOOSING = StageState("choosing_points", "choose_points")

_CAPTURE_TURNS = (1, 2, 4)
"""Turns of the injected direction that a point may be captured for."""


class AdaptiveStage(EnergisedStage):
    """Signal injection, each point where it tells most about the flux map in a second of motor time.

    The rim of what is swept comes first. Then one energy is fitted to all that was measured, the drive disarmed, and
    the next points are chosen by it, until the map's 95 % band is nowhere wider than `until_percent`.
    """

    name = "adaptive"
    title = "adaptive injection"
    measuring = StageState("sweeping_adaptively", "sweep_adaptively")
    records_as = SegmentStage.INJECTION
    working = (CHOOSING,)

    until_percent: Positive = 0.2
    """Half of the flux's 95 % band, in percent of the rated flux."""
    longest_s: Positive = 60.0
    """What the stage may take at most."""
    points_at_once: Annotated[int, Field(ge=1)] = 4
    """How many points are chosen by one map."""
    range_a: Positive | None = None
    """Largest current. None: the classical stage's default amplitude, within limits beside the ripple."""
    amplitude_v: Positive | None = None
    frequency_hz: Positive | None = None
    turn_s: Positive = 0.1
    """How long the injection's direction takes to turn once; a point is captured for one, two or four turns."""
    settle_s: Positive | None = None
    """None: half of what other stages take: the ripple does not mind the last percent of the current."""

    def filled(self, context: StageContext) -> Self:
        scaling = Scaling(context)
        frequency = scaling.injection_hz(self.frequency_hz)
        amplitude = self.amplitude_v or scaling.injection_v("amplitude_v", frequency)
        reach = self.range_a
        if reach is None:
            beside = scaling.beside_ripple_a("amplitude_v", scaling.ripple_a(amplitude, frequency, "square"))
            reach = min(scaling.amplitude_a("range_a"), beside)
        update = {
            "range_a": reach,
            "amplitude_v": amplitude,
            "frequency_hz": frequency,
            "settle_s": self.settle_s or 0.5 * scaling.settle_s(None, self.control),
            "control": scaling.control(self.control),
        }
        filled = self.model_copy(update=update)
        if not len(filled._first) < filled._most <= MAX_POINTS:
            raise scaling.error("longest_s", f"{self.longest_s:g} s are the time of {filled._most} points")
        return filled

    def points(self) -> Iterator[StagePoint]:
        # Where they will be is not known yet: at worst all are on the rim, and captured for longest.
        rim = _ring(given(self.range_a), 24)
        for number in range(self._most):
            yield StagePoint(self._injection(rim[number % len(rim)]))

    @property
    def current_field(self) -> str:
        return "range_a"

    @property
    def voltage_field(self) -> str:
        return "amplitude_v"

    def as_run(self, run: StageRun, planned: Sequence[Excitation]) -> Iterator[Excitation]:
        left = iter([one for one in planned if isinstance(one, Injection)])
        for target in self._first[len(run.segments) :]:
            yield _captured(next(left), target, _CAPTURE_TURNS[0])
        while chosen := self._chosen(run):
            for candidate in chosen:
                if (injection := next(left, None)) is None:
                    return
                yield _captured(injection, candidate.current_a, round(candidate.capture_s / self.turn_s))

    def work(self, run: StageRun) -> None:
        known = self._known(run)
        reached = self._percent(run, known) <= self.until_percent
        wanted = "" if reached else f"; {self.until_percent:g} % were wanted: allow more than longest_s"
        run.publish(Note(level="info" if reached else "warning", text=self._band(run, known) + wanted), durable=True)

    def _chosen(self, run: StageRun) -> list[Candidate]:
        """What to measure next; nothing where what was measured is enough."""
        known = self._known(run)
        if self._percent(run, known) <= self.until_percent:
            return []
        candidates = self._candidates(run)
        target_wb = 0.01 * self.until_percent * self._rated_wb(run, known)
        left_s = known.seconds_to(target_wb, candidates, self.longest_s)
        run.publish(
            Note(level="info", text=f"{self._band(run, known)}; {left_s:.0f} s more for {self.until_percent:g} %")
        )
        return known.best(candidates, self.points_at_once)

    def _known(self, run: StageRun) -> KnownMap:
        """The map of what was measured so far; computed with the drive disarmed."""
        run.enter(CHOOSING)  # before anything that takes its time, as an import does
        from orchestrator.analysis import injected_points, known_map

        delay = run.capabilities.voltage_delay_samples
        points, capture_s = injected_points(run.recording(), run.segments, voltage_delay_samples=delay)
        run.check()
        return known_map(points, capture_s, run.segments[0].rotor_angle_rad, given(self.range_a))

    def _candidates(self, run: StageRun) -> list[Candidate]:
        """Zero and rings up to the rim, on the side of i_q where less was measured: the energy is even in i_q."""
        from orchestrator.analysis import Candidate

        balance = sum(math.copysign(1.0, float(segment.settings["target_q_a"])) for segment in run.segments)
        side = -1.0 if balance > 0 else 1.0
        rings = [_ring(given(self.range_a) * share, 24 * share) for share in (0.25, 0.5, 0.75, 1.0)]
        places = [(0.0, 0.0), *(place for ring in rings for place in ring if side * place[1] >= 0.0)]
        captures = [turns * self.turn_s for turns in _CAPTURE_TURNS]
        return [Candidate(place, one, given(self.settle_s) + one) for place in places for one in captures]

    def _band(self, run: StageRun, known: KnownMap) -> str:
        rated = self._rated_wb(run, known)
        usual, worst = (100.0 * half / rated for half in known.band_wb)
        message = f"{len(run.segments)} points: the flux to ±{worst:.2f} % of the rated flux at worst"
        return f"{message}, ±{usual:.2f} % rms (95 %)"

    def _percent(self, run: StageRun, known: KnownMap) -> float:
        return 100.0 * known.band_wb[1] / self._rated_wb(run, known)

    def _rated_wb(self, run: StageRun, known: KnownMap) -> float:
        rated_a = run.procedure.motor.rated_current_a
        return known.flux_wb((0.0, given(self.range_a) if rated_a is None else rated_a))

    @property
    def _first(self) -> list[Point]:
        """What is measured before anything is known: nothing is delivered outside it."""
        reach = given(self.range_a)
        return [*_ring(reach), *_ring(0.5 * reach, 3)]

    @property
    def _most(self) -> int:
        """How many points there may be, all of them captured for longest."""
        return int(self.longest_s / (given(self.settle_s) + _CAPTURE_TURNS[-1] * self.turn_s))

    def _injection(self, target: Point) -> Injection:
        return Injection(
            target_d_a=target[0],
            target_q_a=target[1],
            settle_s=given(self.settle_s),
            duration_s=_CAPTURE_TURNS[-1] * self.turn_s,
            amplitude_v=given(self.amplitude_v),
            frequency_hz=given(self.frequency_hz),
            rotation_hz=1.0 / self.turn_s,
            control=given(self.control),
        )


def _captured(planned: Injection, target: Point, turns: int) -> Injection:
    """A planned injection elsewhere, and captured for so many turns of its direction."""
    seconds = min(turns / planned.rotation_hz, planned.duration_s)
    return planned.model_copy(update={"target_d_a": target[0], "target_q_a": target[1], "duration_s": seconds})


def _ring(radius_a: float, count: float = 6) -> list[Point]:
    """Points on a circle from +d on, six as far as can be from where a phase current is zero (phase a on d)."""
    turn = 2.0 * math.pi / round(count)
    angles = [turn * k for k in range(round(count))]
    return [(round(radius_a * math.cos(a), 6) + 0.0, round(radius_a * math.sin(a), 6) + 0.0) for a in angles]
