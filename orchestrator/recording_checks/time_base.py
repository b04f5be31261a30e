"""The time base: a sampling frequency that differs from the manifest's, and a voltage that acts earlier or later."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from orchestrator.numerics.alignment import alignment_of
from orchestrator.numerics.types import Array
from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.survey import SegmentReadings, Survey, Vectors, parts
from protocols import Convention, ManifestCorrection, SegmentStage

RATE_FACTORS = (2.0, 10.0, 4.0, 5.0, 8.0, 16.0, 20.0, 100.0, 1000.0)
"""Usual errors of sampling rates: powers of ten, averaging, double update. Any other factor, one drive's rate for
another's, needs two set-points that agree on it."""
MIN_LINE_RATIO = 0.1
"""Size of the weaker spectral line over the stronger one's, below which it is none."""
MIN_RATE_RATIO = 1.1
"""Ratio of two drives' sampling rates, at least."""
MAX_RATE_ERROR = 0.03
"""Relative difference of a time base to the reported factor."""
MAX_RESPONSE_SHARE_BEFORE_DELAY = 0.12
"""Part of the impulse response, in amplitude, that counts as zero."""
MIN_RESPONSE_SHARE_AT_DELAY = 0.3
"""Part of the impulse response that counts as its beginning: half a sample's delay leaves a half in either sample."""
AT_ONCE = (
    "; a current that follows the voltage at once, such as a leak of Ts / L beside the winding, would do the same: "
    "rule it out first, if the rows are known to be right"
)
"""The other hypothesis on a voltage that acts before its time."""
MAX_LAG_ROUNDING_SAMPLES = 0.3
"""Distance of a sine's lag from a whole number of samples, beyond which iron loss or a filter shifts its phase."""


def sampling_rate(responses: Responses) -> Convention | None:
    """A sampling frequency by which every period differs from its set-point by the same factor."""
    survey = responses.survey
    ratios = {
        "injected frequencies": _median(_ripple_ratio(s, survey) for s in survey.injections),
        "turns of the injected direction": _median(_turn_ratio(s, survey) for s in survey.injections),
        "periods of the sweeps": _median(_sweep_ratio(s, survey) for s in survey.of(SegmentStage.CLASSICAL)),
    }
    known = {name: ratio for name, ratio in ratios.items() if ratio is not None}
    from_set_points = list(known.values())
    inductance = responses.inductance_ratio
    resistance = responses.resistance_ratio
    # L scales with the time base and R_s does not.
    if len(known) == 1 and inductance and resistance and abs(math.log(resistance)) < abs(math.log(inductance)):
        known["L, compared with the nameplate"] = inductance
    if len(known) < 2:
        return None
    factor = next((f for k in RATE_FACTORS for f in (k, 1.0 / k) if _all_near(known, f)), None)
    if factor is None:
        factor = _common_factor(from_set_points)
    if factor is None:
        return None
    rate = survey.sampling_frequency_hz * factor
    return Convention(
        kind="sampling_rate",
        what=f"the sampling frequency looks wrong by {1.0 / factor:.4g}",
        evidence=f"{' and '.join(known)} fit {rate:.6g} Hz, and not {survey.sampling_frequency_hz:.6g} Hz",
        correction=ManifestCorrection(
            text=f"set drive.sampling_frequency_hz to {rate:.6g}", field="sampling_frequency_hz", factor=factor
        ),
    )


def _all_near(ratios: dict[str, float], factor: float) -> bool:
    """Whether the first ratio equals the factor within the tolerance, and the others are nearer to no other factor."""
    first, *others = ratios.values()
    return abs(first / factor - 1.0) < MAX_RATE_ERROR and all(1.0 / 1.5 < other / factor < 1.5 for other in others)


def _common_factor(ratios: list[float]) -> float | None:
    """The factor that two or more ratios have in common; None where they differ or it is near one."""
    if len(ratios) < 2 or max(ratios) / min(ratios) - 1.0 > MAX_RATE_ERROR:
        return None
    factor = float(np.median(ratios))
    return factor if abs(math.log(factor)) > math.log(MIN_RATE_RATIO) else None


def _median(ratios: Iterable[float | None]) -> float | None:
    known = [r for r in ratios if r is not None]
    return float(np.median(known)) if known else None


def _ripple_ratio(segment: SegmentReadings, survey: Survey) -> float | None:
    """True sampling frequency over the manifest's, by the injected frequency."""
    frequency_hz = segment.setting("frequency_hz")
    cycles = _cycles_per_sample(segment.ripple_v)
    return None if not frequency_hz or cycles is None else frequency_hz / (cycles * survey.sampling_frequency_hz)


def _turn_ratio(segment: SegmentReadings, survey: Survey) -> float | None:
    """The same ratio by the injected direction: the square of the ripple turns twice as fast, whatever its wave."""
    rotation_hz = segment.setting("rotation_hz")
    if not rotation_hz:
        return None
    square = segment.ripple_v**2
    n = len(square)
    spectrum = np.abs(np.fft.fft(square * np.hanning(n), 4 * n))
    spectrum[: 2 * 4] = spectrum[-2 * 4 + 1 :] = 0.0  # the part that does not turn
    line = int(np.argmax(spectrum))
    turns = min(line, 4 * n - line) / (4 * n) / 2.0
    # Less than one turn in a segment is not identifiable.
    return None if turns * n < 0.8 else rotation_hz / (turns * survey.sampling_frequency_hz)


def _sweep_ratio(segment: SegmentReadings, survey: Survey) -> float | None:
    period, periods = segment.setting("period_s"), segment.setting("periods")
    if not period or not periods:
        return None
    return segment.segment.samples / (period * periods * survey.sampling_frequency_hz)


def _cycles_per_sample(u: Vectors) -> float | None:
    """Frequency of an injected wave whose direction turns: the mean of the strongest lines on either side of zero."""
    # A vector that rotates at the frequency itself has only one line.
    n = len(u)
    spectrum = np.abs(np.fft.fft(u * np.hanning(n)))
    spectrum[:3] = spectrum[-2:] = 0.0
    ahead, behind = int(np.argmax(spectrum[: n // 2])), int(np.argmax(spectrum[: n // 2 : -1])) + 1
    lines = sorted((float(spectrum[place]), abs(place)) for place in (ahead, -behind))
    if lines[1][0] == 0.0:
        return None
    if lines[0][0] < MIN_LINE_RATIO * lines[1][0]:
        return lines[1][1] / n
    if max(ahead, behind) > 2 * min(ahead, behind):
        return None
    return 0.5 * (ahead + behind) / n


def delay(responses: Responses) -> Convention | None:
    """A voltage that acts whole samples earlier or later than the manifest's delay."""
    lag = _lag_of_edges(responses) or _lag_of_phase(responses)
    if lag is None:
        return None
    off, evidence = lag
    declared = responses.survey.manifest.drive.voltage_delay_samples or 0.0
    samples, way = f"{abs(off)} sample{'s' if abs(off) > 1 else ''}", "later" if off > 0 else "earlier"
    text = f"set drive.voltage_delay_samples to {declared + off:g}"
    if declared + off < 0.0:
        text = f"shift the voltage's column by {samples}: row k has the voltage of the one before"
    return Convention(
        kind="delay",
        what=f"the voltage acts {samples} {way} than voltage_delay_samples = {declared:g}",
        evidence=evidence,
        correction=ManifestCorrection(text=text, field="voltage_delay_samples", add=float(off)),
    )


def _lag_of_edges(responses: Responses) -> tuple[int, str] | None:
    """The lag of injected edges in whole samples, and its evidence; None where there is none."""
    response = responses.impulse_response
    if (
        response is None
        or response.deviations.max() > MAX_RESPONSE_SHARE_BEFORE_DELAY * abs(response.weights.sum()) / 4.0
    ):
        return None
    weights = response.weights / response.weights.sum()
    nonzero = np.flatnonzero(weights > MIN_RESPONSE_SHARE_AT_DELAY)
    if not len(nonzero):
        return None
    first = int(nonzero[0])
    if np.any(np.abs(weights[:first]) > MAX_RESPONSE_SHARE_BEFORE_DELAY) or response.lags[first] == 0.0:
        return None
    declared = responses.survey.manifest.drive.voltage_delay_samples or 0.0
    if response.lags[first] < 0.0 and not _is_shifted(weights, first, declared - math.floor(declared)):
        return None
    share = f"{100 * weights[first]:.0f} % of the current's response to injected edges"
    evidence = f"{share} comes there, none before"
    return int(response.lags[first]), evidence + (AT_ONCE if response.lags[first] < 0.0 else "")


def _is_shifted(weights: Array, first: int, fraction: float) -> bool:
    """Whether a response that begins early is the declared one, moved by whole samples.

    A current beside the winding's that follows the voltage at once gives the response [g, 1 - g] from one sample early
    on, g its conductance times L / Ts: an effect for the diagnosis, unless g happens to be 1.
    """
    expected = np.zeros_like(weights)
    expected[first : first + 2] = (1.0 - fraction, fraction)[: len(weights) - first]
    return bool(np.all(np.abs(weights - expected) <= MAX_RESPONSE_SHARE_BEFORE_DELAY))


def _lag_of_phase(responses: Responses) -> tuple[int, str] | None:
    """The lag of injected sines, which have no edges, by their phase; the resistance has to be known.

    A voltage that acts before it is applied has the phase of iron loss, which is the likelier of the two.
    """
    ohm = responses.resistance_ohm or responses.survey.manifest.motor.stator_resistance_ohm
    alignments = [alignment_of(parts(s.i), parts(s.v), ohm=ohm) for s in responses.survey.injections]
    lags = [a.lag_rows for a in alignments if a is not None and not a.by_edges]
    if not lags or ohm is None:
        return None
    declared = responses.survey.manifest.drive.voltage_delay_samples or 0.0
    late = float(np.median(lags)) - declared
    off = round(late)
    if off == 0 or abs(late - off) > MAX_LAG_ROUNDING_SAMPLES or declared + off < 0.0:
        return None
    return off, f"with {ohm:.3g} ohm the phase of the injected sines fits {late:+.1f} samples"
