"""The lock check: saliency seen by injection at rest, under torque of both signs, and at rest again.

At rest a current flows on the d axis, which makes no torque. It keeps the phase currents from passing zero within the
ripple: what an inverter loses then (dead time, device drop) would be taken for inductance, and its change for a turn.

On a motor of little saliency the first rest also shows how noisy the angle is. Where it is too noisy, all five are
captured for longer, that rest included: after torque has acted, the angle before it cannot be measured again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field

from orchestrator.stages import Scaling, given, largest_q_a, stiffest_hold_a
from plugins.stages.estimate import ESTIMATING
from protocols import (
    EnergisedStage,
    Excitation,
    Injection,
    LockChecked,
    NonNegative,
    Note,
    Positive,
    RunAborted,
    SegmentStage,
    StageContext,
    StagePoint,
    StageRun,
    StageState,
)

_TORQUES = (0, 1, 0, -1, 0)
"""Signs of the current on the believed q axis, in order."""


class LockCheckStage(EnergisedStage):
    """Does the rotor move under torque of both signs? A failed check ends the run."""

    name = "lock_check"
    title = "lock check"
    measuring = StageState("checking_lock", "check_lock")
    records_as = SegmentStage.LOCK_CHECK
    working = (ESTIMATING,)
    looks_ahead = True
    least_confidence: ClassVar[float] = 0.5
    """Below it a lock that nothing speaks against is not known."""

    torque_current_a: Positive | None = None
    """Current on the believed q axis. None: the largest of the later stages that leaves room for the ripple."""
    rest_current_a: NonNegative | None = None
    """Current on the d axis at rest and under torque. None: what keeps each phase current from passing zero."""
    amplitude_v: Positive | None = None
    frequency_hz: Positive | None = None
    rotation_hz: Positive | None = None
    settle_s: Positive | None = None
    duration_s: Positive | None = None
    max_duration_ratio: Annotated[float, Field(ge=1.0)] | None = None
    """How many times `duration_s` a point may be captured for where the first rest is too noisy to tell.

    None: 8 where the nameplate's L_q is within 15 % of L_d, else 1: then nothing is added. Less where that adds a
    twentieth of limits.energy_j or limits.duration_s.
    """
    tolerance_rad: Positive = 0.02
    """Largest lasting rotation (electrical) that still counts as locked."""
    accept_not_known: Literal["I have seen that the rotor is held"] | None = None
    """Where the motor shows too little saliency to tell, the run asks the operator, unless this is written out."""

    def filled(self, context: StageContext) -> Self:
        scaling = Scaling(context)
        frequency = scaling.injection_hz(self.frequency_hz)
        rotation, duration = scaling.turns(self.rotation_hz, self.duration_s, frequency)
        amplitude = self.amplitude_v or scaling.injection_v("amplitude_v", frequency)
        ripple = scaling.ripple_a(amplitude, frequency, "square")
        rest, torque = self.rest_current_a, self.torque_current_a
        if rest is None:
            rest = scaling.clear_of_zero_a("amplitude_v", ripple)
        if torque is None:
            others = [stage for stage in context.later if not isinstance(stage, LockCheckStage)]
            wanted = largest_q_a(others) or scaling.amplitude_a("torque_current_a")
            room = scaling.beside_ripple_a("amplitude_v", ripple)
            if rest >= room:
                raise scaling.error(
                    "rest_current_a", f"{rest:g} A leave no room for torque: {room:.3g} A at most in all"
                )
            torque = min(wanted, float(f"{math.sqrt(room**2 - rest**2):.3g}"))
        update = {
            "rest_current_a": rest,
            "torque_current_a": torque,
            "amplitude_v": amplitude,
            "frequency_hz": frequency,
            "rotation_hz": rotation,
            "duration_s": duration,
            "max_duration_ratio": self.max_duration_ratio
            or self._duration_ratio(scaling, context, rest, torque, duration),
            "settle_s": scaling.settle_s(self.settle_s, self.control),
            "control": scaling.control(self.control),
        }
        return self.model_copy(update=update)

    most_of_limits: ClassVar[float] = 0.05
    """Share of the limits on heat and time that longer captures of all lock checks may add."""

    def _duration_ratio(
        self, scaling: Scaling, context: StageContext, rest_a: float, torque_a: float, duration_s: float
    ) -> float:
        """What `max_duration_ratio` is where it is left out."""
        if not scaling.is_weakly_salient:
            return 1.0
        limits, resistance_ohm = context.procedure.limits, context.procedure.motor.stator_resistance_ohm or 0.0
        squared_a2 = sum(rest_a**2 + (sign * torque_a) ** 2 for sign in _TORQUES)
        heat_j = 1.5 * resistance_ohm * squared_a2 * duration_s  # of captures as long as the first
        share = self.most_of_limits / max(1, sum(entry.kind == self.name for entry in context.procedure.stages))
        ratio = 8.0
        for limit, used in ((limits.energy_j, heat_j), (limits.duration_s, len(_TORQUES) * duration_s)):
            if limit is not None and used > 0.0:
                ratio = min(ratio, 1.0 + share * limit / used)
        return float(f"{ratio:.2g}") if ratio >= 2.0 else 1.0

    def points(self) -> Iterator[StagePoint]:
        longest_s = given(self.max_duration_ratio) * given(self.duration_s)
        if longest_s > given(self.duration_s):  # a rest that shows how long the others have to be
            yield StagePoint(self._injection(0, given(self.duration_s)))
        for sign in _TORQUES:
            yield StagePoint(self._injection(sign, longest_s))

    def as_run(self, run: StageRun, planned: Sequence[Excitation]) -> Iterator[Excitation]:
        left = iter([one for one in planned if isinstance(one, Injection)])
        if given(self.max_duration_ratio) == 1.0:
            yield from left
            return
        if not run.segments:
            yield next(left)
        enough, seconds = self._seconds(run)
        signs = _TORQUES[1:] if enough else _TORQUES
        # A resumed run goes on after what is done of them.
        for sign, injection in zip(islice(signs, len(run.segments) - 1, None), left, strict=False):
            target_q_a = sign * given(self.torque_current_a) + 0.0
            whole_turns_s = math.ceil(seconds * injection.rotation_hz - 1e-6) / injection.rotation_hz
            duration_s = min(whole_turns_s, injection.duration_s)
            yield injection.model_copy(update={"target_q_a": target_q_a, "duration_s": duration_s})

    def _seconds(self, run: StageRun) -> tuple[bool, float]:
        """Whether the first rest is long enough, and how long the next points are to be captured [s]."""
        run.enter(ESTIMATING)  # before anything that takes its time, as an import does
        from orchestrator.analysis import lock_duration_ratio

        first = run.segments[0]
        ratio = lock_duration_ratio(
            first,
            run.recording().load(first),
            self.tolerance_rad,
            voltage_delay_samples=run.capabilities.voltage_delay_samples,
        )
        first_s = first.samples / run.capabilities.sampling_frequency_hz
        run.check()
        if ratio <= 1.0:
            return True, first_s
        ratio = min(ratio, given(self.max_duration_ratio))
        text = f"noise hides the rotor's angle in {first_s:.2g} s: captures {ratio:.2g} times as long follow"
        run.publish(Note(level="info", text=f"{self.name}: {text}"))
        return False, ratio * first_s

    def _injection(self, sign: int, duration_s: float) -> Injection:
        return Injection(
            target_d_a=given(self.rest_current_a),
            target_q_a=sign * given(self.torque_current_a) + 0.0,
            settle_s=given(self.settle_s),
            duration_s=duration_s,
            amplitude_v=given(self.amplitude_v),
            frequency_hz=given(self.frequency_hz),
            rotation_hz=given(self.rotation_hz),
            control=given(self.control),
        )

    @property
    def current_field(self) -> str:
        return "torque_current_a"

    @property
    def voltage_field(self) -> str:
        return "amplitude_v"

    def work(self, run: StageRun) -> None:
        verdict = self._verdict(run)
        run.publish(verdict, durable=True)
        if verdict.locked is None:
            # What cannot be measured has to be known by a person, here or in the procedure.
            run.publish(Note(level="warning", text=f"{verdict.summary}; {self.name}.accept_not_known accepts that"))
            run.ask(
                "Whether the rotor is locked cannot be measured on this motor. Have you seen that it is held?",
                answered=self.accept_not_known is not None,
            )
        elif not verdict.locked:
            raise RunAborted(f"the rotor is not locked: {verdict.summary}")

    def _verdict(self, run: StageRun) -> LockChecked:
        run.enter(ESTIMATING)  # before anything that takes its time, as an import does
        from orchestrator.analysis import judge_lock

        recording = run.recording()
        verdict = judge_lock(
            [(segment, recording.load(segment)) for segment in run.segments[-len(_TORQUES) :]],
            self.tolerance_rad,
            voltage_delay_samples=run.capabilities.voltage_delay_samples,
            aligning_current_a=2.0 * stiffest_hold_a(run.procedure.motor),
        )
        if verdict.locked and verdict.confidence < self.least_confidence:
            return verdict.model_copy(update={"locked": None})
        return verdict
