"""What was captured, held against what was asked for: scales, exchanged or inverted phases, and the rotor's angle."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.criteria import ConventionCriteria
from orchestrator.recording_checks.responses import AtRest, Responses
from orchestrator.recording_checks.survey import Sighting, Survey, Vectors
from orchestrator.recording_checks.vector_maps import (
    CURRENT_SCALES,
    DEAD,
    EXCHANGES,
    INVERTED,
    SAME,
    VOLTAGE_SCALES,
    VectorMap,
)
from protocols import Convention, ManifestCorrection

Field = Literal["currents", "voltages"]


@dataclass(frozen=True)
class Match:
    """Hypotheses that explain the readings, the best first, and how ill they are explained without one.

    Attributes
    ----------
    fitting : tuple of (VectorMap, float)
        Each with its error, relative to the vectors; several where the readings cannot tell them apart.
    error_as_is : float
    """

    fitting: tuple[tuple[VectorMap, float], ...]
    error_as_is: float


def current_match(survey: Survey) -> Match | None:
    """Mean currents of holds (of injections, where there are none) against their set-points; None without any."""
    asked, reached = _set_points(survey.holds)
    if not len(asked):
        asked, reached = _set_points(survey.injections)
    if not len(asked):
        return None
    large = np.abs(asked) >= survey.criteria.least_set_point * np.abs(asked).max()
    asked, reached = asked[large], reached[large]

    def error(of: VectorMap) -> float:
        made = of(asked)
        return float(np.linalg.norm(reached - made) / max(np.linalg.norm(made), 1e-3 * np.linalg.norm(asked)))

    spans = np.linalg.svd(np.stack([asked.real, asked.imag]), compute_uv=False).min() > 0.1 * np.linalg.norm(asked)
    tried = [*CURRENT_SCALES, *((*EXCHANGES, *INVERTED, *DEAD) if spans else EXCHANGES[:1])]
    return _match(tried, error, survey.criteria)


def _set_points(seen: Sequence[Sighting]) -> tuple[Vectors, Vectors]:
    pairs = [(s.set_point, s.mean_i) for s in seen if s.set_point]
    asked, reached = zip(*pairs, strict=True) if pairs else ((), ())
    return np.array(asked, dtype=np.complex128), np.array(reached, dtype=np.complex128)


def voltage_match(survey: Survey) -> Match | None:
    """The injected voltage against its amplitude and its turning direction; None where either was not given.

    The wave's sign is not known, so that squares are compared: of a u + b conj(u) with u = A exp(j phi) these are a² A²
    exp(2j phi), b² A² exp(-2j phi) and 2 a b A².
    """
    shown = [row for s in survey.injections if (row := _squares(s, survey)) is not None]
    if not shown:
        return None
    asked, found = (np.array(x) for x in zip(*shown, strict=True))
    turning = bool(np.all(np.isfinite(found)))

    def error(of: VectorMap) -> float:
        if not turning:
            return float(abs(np.mean(np.sqrt(found[:, 1].real)) / abs(of.a) - 1.0))
        made = np.stack([of.a**2 * asked, np.full_like(asked, 2.0 * of.a * of.b), of.b**2 * np.conj(asked)], axis=1)
        # Half: a square errs twice as much as what was squared.
        return float(0.5 * np.linalg.norm(found - made) / np.linalg.norm(made))

    tried = [*VOLTAGE_SCALES, *((*EXCHANGES, *INVERTED, *DEAD) if turning else ())]
    return _match(tried, error, survey.criteria)


def _squares(seen: Sighting, survey: Survey) -> tuple[complex, tuple[complex, complex, complex]] | None:
    """exp(2j theta), and the three parts of (u/A)²; only their sum of sizes where the direction hardly turns."""
    amplitude, turns_hz = seen.asked("amplitude_v"), seen.asked("rotation_hz") or 0.0
    if not amplitude:
        return None
    if seen.segment.settings.get("waveform") == "sine":
        amplitude /= math.sqrt(2.0)
    u, fs = seen.ripple_v / amplitude, survey.sampling_frequency_hz
    if len(u) * turns_hz / fs < survey.criteria.least_turns:
        return 1.0, (math.nan, complex(np.mean(np.abs(u) ** 2)), math.nan)
    n = round(max(round(2.0 * len(u) * turns_hz / fs), 1) * fs / (2.0 * turns_hz))
    phase = np.exp(-4j * np.pi * turns_hz / fs * np.arange(min(n, len(u))))
    square = u[: len(phase)] ** 2
    parts = (np.mean(square * phase), np.mean(square), np.mean(square * np.conj(phase)))
    return cmath.exp(2j * seen.theta_rad), (complex(parts[0]), complex(parts[1]), complex(parts[2]))


def _match(tried: Sequence[VectorMap], error: Callable[[VectorMap], float], limits: ConventionCriteria) -> Match:
    as_is = error(SAME)
    found = sorted(((m, error(m)) for m in tried), key=lambda pair: pair[1]) if as_is > limits.unlike else []
    return Match(tuple(pair for pair in found if pair[1] < limits.alike), as_is)


def against_set_points(seen: Responses) -> Convention | None:
    """The hypothesis on currents or voltages that makes readings agree with set-points, and with each other."""
    survey = seen.survey
    matches: tuple[tuple[Field, Match | None], ...] = (
        ("currents", current_match(survey)),
        ("voltages", voltage_match(survey)),
    )
    for field, match in matches:
        for of, error in () if match is None else match.fitting:
            if match is not None and _borne_out(seen, field, of):
                told = f"set-points fit within {100 * error:.1f} % then, and {100 * match.error_as_is:.0f} % as it is"
                return named(field, of, told + (_beside_nameplate(seen) if of.kind == "scaled" else ""))
    return rotor_angle(seen)


def without_set_points(seen: Responses) -> Convention | None:
    """Exchanged or inverted phases by the resistive voltage alone, which has the current's direction in any motor."""
    limits, rest, match = seen.survey.criteria, seen.rest, current_match(seen.survey)
    if rest is None or not rest.whole_plane:
        return None
    a, b = rest.law()
    if abs(b) < limits.wrong_way * abs(a) and abs(cmath.phase(a)) < math.pi / 3.0:
        return None
    currents_are_right = match is not None and match.error_as_is < limits.alike
    field: Field = "voltages" if currents_are_right else "currents"
    fitting = [m for m in (*EXCHANGES, *INVERTED) if _fits_at_rest(rest, field, m, limits)]
    if len({m.what for m in fitting}) != 1:
        return None
    evidence = "the resistive voltage has the current's direction in every hold then, and not as it is"
    return named(field, fitting[0], evidence, or_else="" if currents_are_right else "or the voltages are")


def _fits_at_rest(rest: AtRest, field: Field, of: VectorMap, limits: ConventionCriteria) -> bool:
    back = of.undone
    if back is None:
        return False
    return resistive(rest.law(back) if field == "currents" else rest.law(v_map=back), limits)


def resistive(law: tuple[complex, complex], limits: ConventionCriteria) -> bool:
    """Whether the voltage at rest is the current's, times a resistance."""
    a, b = law
    return abs(b) < limits.right_way * abs(a) and abs(cmath.phase(a)) < limits.right_angle_rad


def _borne_out(seen: Responses, field: Field, of: VectorMap) -> bool:
    """Whether currents and voltages themselves speak for it: set-points can be in other units than the readings."""
    limits, rest = seen.survey.criteria, seen.rest
    if of.factor is not None and of.factor > 0.0:
        gain = math.log(of.factor) * (-1.0 if field == "currents" else 1.0)
        # Saturation makes of L what it likes; it is asked where R is not known.
        ratio = seen.resistance_ratio or seen.inductance_ratio
        return ratio is None or math.log(ratio) / gain > limits.borne_out
    if rest is None or not rest.whole_plane or of.undone is None:
        return True
    return _fits_at_rest(rest, field, of, limits) and not resistive(rest.law(), limits)


def _beside_nameplate(seen: Responses) -> str:
    ohm = seen.survey.manifest.motor.stator_resistance_ohm
    return (
        ""
        if seen.resistance_ratio is None or ohm is None
        else (f"; R_s {seen.resistance_ratio * ohm:.3g} ohm as it is, where the nameplate has {ohm:.3g} ohm")
    )


def named(field: Field, of: VectorMap, evidence: str, or_else: str = "") -> Convention:
    """A map of vectors as a convention, with the map back as its correction."""
    what = f"the {field} look {of.what}" + (f", {or_else}" if or_else else "")
    back = of.undone
    if back is None or of.kind == "dead":
        text = f"the {field} are not all there: measure again"
        return Convention(kind="dead_channel", what=what, evidence=evidence, correction=ManifestCorrection(text=text))
    if back.factor is not None:
        text = f"multiply the {field} by {back.factor:.4g}"
        correction = ManifestCorrection(text=text, field=field, factor=back.factor)
    else:
        (aa, ab), (ba, bb) = (back.matrix.round(12) + 0.0).tolist()
        text = (
            f"undo it in the mapping of the {field}: (alpha, beta) times [[{aa:.4g}, {ab:.4g}], [{ba:.4g}, {bb:.4g}]]"
        )
        correction = ManifestCorrection(text=text, field=field, matrix=((aa, ab), (ba, bb)))
    return Convention(kind=f"{of.kind}_{field}", what=what, evidence=evidence, correction=correction)


def rotor_angle(seen: Responses) -> Convention | None:
    """Set-points and readings that differ by a turn, while currents and voltages agree: the angle in the manifest."""
    survey, limits = seen.survey, seen.survey.criteria
    shown = [s for s in survey.holds or survey.injections if s.set_point]
    if not shown or (seen.rest is not None and seen.rest.whole_plane and not resistive(seen.rest.law(), limits)):
        return None
    asked, reached = _set_points(shown)
    theta = np.array([s.theta_rad for s in shown])
    turn = cmath.phase(complex(np.vdot(asked, reached)))

    def error(by_rad: Array | float) -> float:
        return float(np.linalg.norm(reached - asked * np.exp(1j * np.asarray(by_rad))) / np.linalg.norm(asked))

    if error(0.0) < 2.0 * math.sin(limits.turned_rad / 2.0):
        return None
    evidence = (
        f"readings are turned by {math.degrees(turn):.3g} degrees against their set-points, the voltage with them"
    )
    pairs = survey.manifest.motor.pole_pairs
    units = [("mechanical_angle", float(pairs), "mechanical, not electrical", f"multiply by the {pairs} pole pairs")]
    if np.abs(theta).max() > 2.0 * math.pi:
        units.insert(0, ("angle_unit", math.radians(1.0), "in degrees", "multiply by pi/180"))
    for kind, factor, what, text in units:
        if error((factor - 1.0) * theta) < limits.alike:
            correction = ManifestCorrection(text=text, field="rotor_angle_rad", factor=factor)
            return Convention(kind=kind, what=f"rotor_angle_rad looks {what}", evidence=evidence, correction=correction)
    if error(turn) > limits.alike:
        return None
    what = f"rotor_angle_rad looks {math.degrees(-turn):.3g} degrees off"
    correction = ManifestCorrection(text=f"add {turn:.4g} rad to rotor_angle_rad", field="rotor_angle_rad", add=turn)
    return Convention(kind="rotor_angle", what=what, evidence=evidence, correction=correction)
