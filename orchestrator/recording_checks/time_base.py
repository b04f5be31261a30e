"""The time base: a sampling frequency that is not the one in the manifest, and a voltage that acts earlier or later."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from orchestrator.numerics.alignment import alignment_of
from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.survey import Sighting, Survey, Vectors, parts
from protocols import Convention, ManifestCorrection, SegmentStage

FACTORS = (2.0, 10.0, 4.0, 5.0, 8.0, 16.0, 20.0, 100.0, 1000.0)
"""By which sampling rates are mistaken: bases of ten, averaging, double update. Any other, one drive's rate for
another's, has to be told by two of what was asked for alike."""
ONE_LINE = 0.1
"""Of the stronger line's size, below which the other is none."""
OTHER_DRIVE = 1.1
"""Of two drives' rates, at least."""


def sampling_rate(seen: Responses) -> Convention | None:
    """A time base that puts every period that was asked for off by the same factor."""
    survey, limits = seen.survey, seen.survey.criteria
    ratios = {
        "injected frequencies": _median(_ripple_ratio(s, survey) for s in survey.injections),
        "turns of the injected direction": _median(_turn_ratio(s, survey) for s in survey.injections),
        "periods of the sweeps": _median(_sweep_ratio(s, survey) for s in survey.of(SegmentStage.CLASSICAL)),
    }
    found = {name: ratio for name, ratio in ratios.items() if ratio is not None}
    asked = list(found.values())
    inductance = seen.inductance_ratio
    resistance = seen.resistance_ratio
    # L goes with the time base and R_s does not.
    if len(found) == 1 and inductance and resistance and abs(math.log(resistance)) < abs(math.log(inductance)):
        found["L, beside the nameplate's"] = inductance
    if len(found) < 2:
        return None
    factor = next((f for k in FACTORS for f in (k, 1.0 / k) if _all_near(found, f, limits.same_rate)), None)
    if factor is None:
        factor = _alike(asked, limits.same_rate)
    if factor is None:
        return None
    rate = survey.sampling_frequency_hz * factor
    return Convention(
        kind="sampling_rate",
        what=f"the sampling frequency looks wrong by {1.0 / factor:.4g}",
        evidence=f"{' and '.join(found)} fit {rate:.6g} Hz, and not {survey.sampling_frequency_hz:.6g} Hz",
        correction=ManifestCorrection(
            text=f"set drive.sampling_frequency_hz to {rate:.6g}", field="sampling_frequency_hz", factor=factor
        ),
    )


def _all_near(found: dict[str, float], factor: float, same: float) -> bool:
    """The first to some percent, what backs it so that no other factor is meant."""
    first, *others = found.values()
    return abs(first / factor - 1.0) < same and all(1.0 / 1.5 < other / factor < 1.5 for other in others)


def _alike(asked: list[float], same: float) -> float | None:
    """A factor that two or more of what was asked for have in common, if it is none of how well such are read."""
    if len(asked) < 2 or max(asked) / min(asked) - 1.0 > same:
        return None
    factor = float(np.median(asked))
    return factor if abs(math.log(factor)) > math.log(OTHER_DRIVE) else None


def _median(ratios: Iterable[float | None]) -> float | None:
    there = [r for r in ratios if r is not None]
    return float(np.median(there)) if there else None


def _ripple_ratio(seen: Sighting, survey: Survey) -> float | None:
    """True sampling frequency over the manifest's, by the injected frequency."""
    asked = seen.asked("frequency_hz")
    cycles = _line_per_sample(seen.ripple_v)
    return None if not asked or cycles is None else asked / (cycles * survey.sampling_frequency_hz)


def _turn_ratio(seen: Sighting, survey: Survey) -> float | None:
    """The same, by the injected direction: the square of the ripple turns twice as fast, whatever its wave."""
    asked = seen.asked("rotation_hz")
    if not asked:
        return None
    square = seen.ripple_v**2
    n = len(square)
    spectrum = np.abs(np.fft.fft(square * np.hanning(n), 4 * n))
    spectrum[: 2 * 4] = spectrum[-2 * 4 + 1 :] = 0.0  # what does not turn
    line = int(np.argmax(spectrum))
    turns = min(line, 4 * n - line) / (4 * n) / 2.0
    # A turn that the segment holds less than once is not seen.
    return None if turns * n < 0.8 else asked / (turns * survey.sampling_frequency_hz)


def _sweep_ratio(seen: Sighting, survey: Survey) -> float | None:
    period, periods = seen.asked("period_s"), seen.asked("periods")
    if not period or not periods:
        return None
    return seen.segment.samples / (period * periods * survey.sampling_frequency_hz)


def _line_per_sample(u: Vectors) -> float | None:
    """Frequency of an injected wave whose direction turns: the mean of the two strongest lines on either side.

    A vector that rotates at the frequency itself has but one.
    """
    n = len(u)
    spectrum = np.abs(np.fft.fft(u * np.hanning(n)))
    spectrum[:3] = spectrum[-2:] = 0.0
    ahead, behind = int(np.argmax(spectrum[: n // 2])), int(np.argmax(spectrum[: n // 2 : -1])) + 1
    lines = sorted((float(spectrum[place]), abs(place)) for place in (ahead, -behind))
    if lines[1][0] == 0.0:
        return None
    if lines[0][0] < ONE_LINE * lines[1][0]:
        return lines[1][1] / n
    if max(ahead, behind) > 2 * min(ahead, behind):
        return None
    return 0.5 * (ahead + behind) / n


def delay(seen: Responses) -> Convention | None:
    """A voltage that acts whole samples earlier or later than the manifest says."""
    told = _by_edges(seen) or _by_phase(seen)
    if told is None:
        return None
    off, evidence = told
    declared = seen.survey.manifest.drive.voltage_delay_samples or 0.0
    samples, way = f"{abs(off)} sample{'s' if abs(off) > 1 else ''}", "later" if off > 0 else "earlier"
    text = f"set drive.voltage_delay_samples to {declared + off:g}"
    correction = ManifestCorrection(text=text, field="voltage_delay_samples", add=float(off))
    if declared + off < 0.0:
        text = f"shift the voltage's column by {samples}: row k has the voltage of the one before"
        correction = ManifestCorrection(text=text, field="voltage_delay_samples", add=float(off))
    return Convention(
        kind="delay",
        what=f"the voltage acts {samples} {way} than voltage_delay_samples = {declared:g}",
        evidence=evidence,
        correction=correction,
    )


def _by_edges(seen: Responses) -> tuple[int, str] | None:
    """Whole samples, and what speaks for them."""
    limits, found = seen.survey.criteria, seen.answer
    if found is None or found.deviations.max() > limits.no_answer * abs(found.weights.sum()) / 4.0:
        return None
    weights = found.weights / found.weights.sum()
    answered = np.flatnonzero(weights > limits.answer)
    if not len(answered):
        return None
    first = int(answered[0])
    if np.any(np.abs(weights[:first]) > limits.no_answer) or found.lags[first] == 0.0:
        return None
    share = f"{100 * weights[first]:.0f} % of the current's answer to injected edges"
    return int(found.lags[first]), f"{share} is there, none before"


def _by_phase(seen: Responses) -> tuple[int, str] | None:
    """The same of sines, which have no edges: by their phase, with the resistance known."""
    ohm = seen.resistance_ohm or seen.survey.manifest.motor.stator_resistance_ohm
    told = [alignment_of(parts(s.i), parts(s.v), ohm=ohm) for s in seen.survey.injections]
    lags = [found.lag_rows for found in told if found is not None and not found.by_edges]
    if not lags or ohm is None:
        return None
    late = float(np.median(lags)) - (seen.survey.manifest.drive.voltage_delay_samples or 0.0)
    off = round(late)
    if off == 0 or abs(late - off) > seen.survey.criteria.part_of_a_sample:
        return None
    return off, f"with {ohm:.3g} ohm the phase of the injected sines fits {late:+.1f} samples"
