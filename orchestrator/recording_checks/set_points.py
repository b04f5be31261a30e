"""Readings compared with their set-points: scales, exchanged or inverted phases, and the rotor's angle."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.responses import Responses, SteadyState
from orchestrator.recording_checks.survey import (
    MAX_MATCH_ERROR,
    MIN_CURRENT_FRACTION,
    MIN_MISMATCH_ERROR,
    SegmentReadings,
    Survey,
    Vectors,
)
from orchestrator.recording_checks.vector_maps import (
    CURRENT_SCALES,
    DEAD,
    EXCHANGES,
    IDENTITY,
    INVERTED,
    VOLTAGE_SCALES,
    VectorMap,
)
from protocols import Convention, ManifestCorrection

Field = Literal["currents", "voltages"]

MIN_INJECTION_TURNS = 0.9
"""Turns of an injected direction that show its start and its sense of rotation."""
MIN_CONJUGATE_FRACTION_WRONG = 0.5
"""Minimum share of the resistive voltage that rotates backwards with exchanged phases; imbalance gives 0.1."""
MAX_CONJUGATE_FRACTION_RIGHT = 0.2
"""Maximum of this share under the right hypothesis, from dead time and imbalance."""
MAX_IMPEDANCE_ANGLE_RAD = 0.25
"""Maximum angle between voltage and current at rest under the right hypothesis."""
MIN_LOG_SCALE_FRACTION = 0.33
"""Minimum log(R / R_nameplate) / log(scale) that blames the readings; below it the set-points are in other units."""
MIN_ANGLE_ERROR_RAD = 0.1
"""Minimum angle from set-points to readings that counts as an error of the manifest's rotor angle."""


@dataclass(frozen=True)
class Match:
    """Hypotheses that explain the readings, the best first, and the error without one.

    Attributes
    ----------
    fitting : tuple of (VectorMap, float)
        Each with its error, relative to the vectors; several where the readings do not separate them.
    error_as_is : float
        Relative error of the readings without any map.
    """

    fitting: tuple[tuple[VectorMap, float], ...]
    error_as_is: float


def current_match(survey: Survey) -> Match | None:
    """Mean currents of holds (of injections, where there are none) against their set-points; None without any."""
    set_points, reached = _set_points(survey.holds)
    if not len(set_points):
        set_points, reached = _set_points(survey.injections)
    if not len(set_points):
        return None
    large = np.abs(set_points) >= MIN_CURRENT_FRACTION * np.abs(set_points).max()
    set_points, reached = set_points[large], reached[large]

    def error(m: VectorMap) -> float:
        mapped = m(set_points)
        return float(np.linalg.norm(reached - mapped) / max(np.linalg.norm(mapped), 1e-3 * np.linalg.norm(set_points)))

    width = np.linalg.svd(np.stack([set_points.real, set_points.imag]), compute_uv=False).min()
    spans_plane = width > 0.1 * np.linalg.norm(set_points)
    tried = [*CURRENT_SCALES, *((*EXCHANGES, *INVERTED, *DEAD) if spans_plane else EXCHANGES[:1])]
    return _match(tried, error)


def _set_points(readings: Sequence[SegmentReadings]) -> tuple[Vectors, Vectors]:
    pairs = [(s.set_point, s.mean_i) for s in readings if s.set_point]
    set_points, reached = zip(*pairs, strict=True) if pairs else ((), ())
    return np.array(set_points, dtype=np.complex128), np.array(reached, dtype=np.complex128)


def voltage_match(survey: Survey) -> Match | None:
    """The injected voltage against its amplitude and rotating direction; None where either was not given.

    The wave's sign is unknown, so squares are compared: of a u + b conj(u) with u = A exp(j phi) these are a² A²
    exp(2j phi), b² A² exp(-2j phi) and 2 a b A²: components at +2, -2 and 0 times the rotation.
    """
    rows = [row for s in survey.injections if (row := _squares(s, survey)) is not None]
    if not rows:
        return None
    turn, squares = (np.array(x) for x in zip(*rows, strict=True))
    turning = bool(np.all(np.isfinite(squares)))

    def error(m: VectorMap) -> float:
        if not turning:
            return float(abs(np.mean(np.sqrt(np.maximum(squares[:, 1].real, 0.0))) / abs(m.a) - 1.0))
        expected = np.stack([m.a**2 * turn, np.full_like(turn, 2.0 * m.a * m.b), m.b**2 * np.conj(turn)], axis=1)
        # Half: the relative error of a square is twice that of its root.
        return float(0.5 * np.linalg.norm(squares - expected) / np.linalg.norm(expected))

    tried = [*VOLTAGE_SCALES, *((*EXCHANGES, *INVERTED, *DEAD) if turning else ())]
    return _match(tried, error)


def _squares(readings: SegmentReadings, survey: Survey) -> tuple[complex, tuple[complex, complex, complex]] | None:
    """exp(2j theta), and the three parts of (u/A)²; only the mean of |u/A|² where the direction hardly turns."""
    amplitude, rotation_hz = readings.setting("amplitude_v"), readings.setting("rotation_hz") or 0.0
    if not amplitude:
        return None
    if readings.segment.settings.get("waveform") == "sine":
        amplitude /= math.sqrt(2.0)
    u, fs = readings.ripple_v / amplitude, survey.sampling_frequency_hz
    if len(u) * rotation_hz / fs < MIN_INJECTION_TURNS:
        return 1.0, (math.nan, complex(np.mean(np.abs(u) ** 2)), math.nan)
    n = round(max(round(2.0 * len(u) * rotation_hz / fs), 1) * fs / (2.0 * rotation_hz))
    phase = np.exp(-4j * np.pi * rotation_hz / fs * np.arange(min(n, len(u))))
    square = u[: len(phase)] ** 2
    components = (np.mean(square * phase), np.mean(square), np.mean(square * np.conj(phase)))
    return cmath.exp(2j * readings.theta_rad), (complex(components[0]), complex(components[1]), complex(components[2]))


def _match(tried: Sequence[VectorMap], error: Callable[[VectorMap], float]) -> Match:
    as_is = error(IDENTITY)
    ranked = sorted(((m, error(m)) for m in tried), key=lambda pair: pair[1]) if as_is > MIN_MISMATCH_ERROR else []
    return Match(tuple(pair for pair in ranked if pair[1] < MAX_MATCH_ERROR), as_is)


def against_set_points(responses: Responses) -> Convention | None:
    """The map of currents or voltages that makes readings agree with set-points, and with each other."""
    survey = responses.survey
    matches: tuple[tuple[Field, Match | None], ...] = (
        ("currents", current_match(survey)),
        ("voltages", voltage_match(survey)),
    )
    for field, match in matches:
        for m, error in () if match is None else match.fitting:
            if match is not None and _supported(responses, field, m):
                evidence = (
                    f"readings differ from their set-points by {100 * match.error_as_is:.0f} %, and by "
                    f"{100 * error:.1f} % after correction"
                )
                return vector_convention(
                    field,
                    m,
                    evidence + (_nameplate_evidence(responses) if m.kind == "scaled" else ""),
                )
    return rotor_angle(responses)


def without_set_points(responses: Responses) -> Convention | None:
    """Exchanged or inverted phases by the resistive voltage alone, which has the current's direction in any motor."""
    steady, match = responses.steady_state, current_match(responses.survey)
    if steady is None or not steady.whole_plane:
        return None
    a, b = steady.impedance()
    if abs(b) < MIN_CONJUGATE_FRACTION_WRONG * abs(a) and abs(cmath.phase(a)) < math.pi / 3.0:
        return None
    currents_are_right = match is not None and match.error_as_is < MAX_MATCH_ERROR
    field: Field = "voltages" if currents_are_right else "currents"
    fitting = [m for m in (*EXCHANGES, *INVERTED) if _fits_at_rest(steady, field, m)]
    if len({m.what for m in fitting}) != 1:
        return None
    evidence = "the resistive voltage has the current's direction in every hold after correction, and not before"
    return vector_convention(field, fitting[0], evidence, other="" if currents_are_right else "or the voltages are")


def _fits_at_rest(steady: SteadyState, field: Field, m: VectorMap) -> bool:
    inverse = m.inverse
    if inverse is None:
        return False
    return resistive(steady.impedance(inverse) if field == "currents" else steady.impedance(v_map=inverse))


def resistive(law: tuple[complex, complex]) -> bool:
    """Whether the voltage at rest is the current times a resistance."""
    a, b = law
    return abs(b) < MAX_CONJUGATE_FRACTION_RIGHT * abs(a) and abs(cmath.phase(a)) < MAX_IMPEDANCE_ANGLE_RAD


def _supported(responses: Responses, field: Field, m: VectorMap) -> bool:
    """Whether currents and voltages themselves support it, as set-points can be in other units than the readings."""
    steady = responses.steady_state
    if m.factor is not None and m.factor > 0.0:
        gain = math.log(m.factor) * (-1.0 if field == "currents" else 1.0)
        # Saturation changes L widely; it serves only where R is not known.
        ratio = responses.resistance_ratio or responses.inductance_ratio
        return ratio is None or math.log(ratio) / gain > MIN_LOG_SCALE_FRACTION
    if steady is None or not steady.whole_plane or m.inverse is None:
        return True
    return _fits_at_rest(steady, field, m) and not resistive(steady.impedance())


def _nameplate_evidence(responses: Responses) -> str:
    ohm = responses.survey.manifest.motor.stator_resistance_ohm
    if responses.resistance_ratio is None or ohm is None:
        return ""
    return f"; R_s is {responses.resistance_ratio * ohm:.3g} ohm by the readings and {ohm:.3g} ohm on the nameplate"


def vector_convention(field: Field, m: VectorMap, evidence: str, other: str = "") -> Convention:
    """A wrong map of vectors as a convention, with the inverse map as its correction."""
    what = f"the {field} look {m.what}" + (f", {other}" if other else "")
    inverse = m.inverse
    if inverse is None or m.kind == "dead":
        text = f"the {field} are incomplete: measure again"
        return Convention(kind="dead_channel", what=what, evidence=evidence, correction=ManifestCorrection(text=text))
    if inverse.factor is not None:
        text = f"multiply the {field} by {inverse.factor:.4g}"
        correction = ManifestCorrection(text=text, field=field, factor=inverse.factor)
    else:
        (aa, ab), (ba, bb) = (inverse.matrix.round(12) + 0.0).tolist()
        text = (
            f"undo it in the mapping of the {field}: (alpha, beta) times [[{aa:.4g}, {ab:.4g}], [{ba:.4g}, {bb:.4g}]]"
        )
        correction = ManifestCorrection(text=text, field=field, matrix=((aa, ab), (ba, bb)))
    return Convention(kind=f"{m.kind}_{field}", what=what, evidence=evidence, correction=correction)


def rotor_angle(responses: Responses) -> Convention | None:
    """A wrong angle in the manifest: set-points are rotated from readings, while currents and voltages agree."""
    survey = responses.survey
    segments = [s for s in survey.holds or survey.injections if s.set_point]
    if not segments or (
        responses.steady_state is not None
        and responses.steady_state.whole_plane
        and not resistive(responses.steady_state.impedance())
    ):
        return None
    set_points, reached = _set_points(segments)
    theta = np.array([s.theta_rad for s in segments])
    turn = cmath.phase(complex(np.vdot(set_points, reached)))

    def error(by_rad: Array | float) -> float:
        return float(
            np.linalg.norm(reached - set_points * np.exp(1j * np.asarray(by_rad))) / np.linalg.norm(set_points)
        )

    if error(0.0) < 2.0 * math.sin(MIN_ANGLE_ERROR_RAD / 2.0):
        return None
    evidence = f"readings are rotated by {math.degrees(turn):.3g} degrees from their set-points, the voltage with them"
    pairs = survey.manifest.motor.pole_pairs
    units = [("mechanical_angle", float(pairs), "mechanical, not electrical", f"multiply by the {pairs} pole pairs")]
    if np.abs(theta).max() > 2.0 * math.pi:
        units.insert(0, ("angle_unit", math.radians(1.0), "in degrees", "multiply by pi/180"))
    for kind, factor, what, text in units:
        if error((factor - 1.0) * theta) < MAX_MATCH_ERROR:
            correction = ManifestCorrection(text=text, field="rotor_angle_rad", factor=factor)
            return Convention(kind=kind, what=f"rotor_angle_rad looks {what}", evidence=evidence, correction=correction)
    if error(turn) > MAX_MATCH_ERROR:
        return None
    what = f"rotor_angle_rad looks {math.degrees(-turn):.3g} degrees off"
    correction = ManifestCorrection(text=f"add {turn:.4g} rad to rotor_angle_rad", field="rotor_angle_rad", add=turn)
    return Convention(kind="rotor_angle", what=what, evidence=evidence, correction=correction)
