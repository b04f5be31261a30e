"""A fleet's report as rows of text, the head first, for terminal, page and viewer."""

from __future__ import annotations

from collections.abc import Callable

from orchestrator.formatting.names import parameter_words, plain
from orchestrator.formatting.quantities import UNKNOWN, number, percent, quantity, value_and_error, value_and_interval
from protocols.fleet_priors import FleetPriors
from protocols.fleet_report import FleetJudgement, FleetPairs, FleetRecording, FleetReport

Rows = list[tuple[str, ...]]
_JUDGEMENTS = {"fail": "fails", "unsure": "undecided", "not_measured": "not measured", "pass": "passes"}


def distribution_rows(report: FleetReport) -> Rows:
    """Middle, spread and quantiles of each quantity."""
    head = ("quantity", "known of", "median", "spread", "1 %", "5 %", "95 %", "99 %", "own 95 % interval")
    rows = []
    for one in report.quantities:
        at = {q.share: q.value for q in one.quantiles}
        shown = (one.middle, one.spread, *(at.get(share) for share in (0.01, 0.05, 0.95, 0.99)))
        half = UNKNOWN if one.typical_interval is None else f"± {quantity(one.typical_interval, one.unit, 2)}"
        values = (quantity(value, one.unit, 4) for value in shown)
        rows.append((one.label, f"{one.count} of {one.asked}", *values, half))
    return [head, *rows]


def course_rows(report: FleetReport) -> Rows:
    """Drift and control chart of each quantity."""
    head = ("quantity", "a day", "95 %", "drifts", "chart beyond its limits", "first")
    rows = []
    for one in report.quantities:
        if one.drift is None and one.chart is None:
            continue
        slope, interval = (UNKNOWN, "")
        if one.drift is not None:
            slope, interval = value_and_interval(one.drift.per_day, one.drift.low, one.drift.high, one.unit)
        beyond = UNKNOWN if one.chart is None else f"{one.chart.beyond} of {one.count}"
        first = one.chart.first_beyond if one.chart is not None else None
        drifts = _yes(one.drift is not None and one.drift.drifts)
        rows.append((one.label, slope, interval, drifts, beyond, "" if first is None else date(first)))
    return [head, *rows] if rows else []


def batch_rows(report: FleetReport) -> Rows:
    """Each batch against all others, the most significant first."""
    head = ("batch", "quantity", "recordings", "median", "difference to the others", "95 %", "shifted")
    batches = sorted(((b.chance, b, one) for one in report.quantities for b in one.batches), key=lambda row: row[0])
    rows = [
        (
            b.batch,
            one.label,
            str(b.count),
            quantity(b.middle, one.unit, 4),
            *value_and_interval(b.shift, b.low, b.high, one.unit),
            _yes(b.shifted),
        )
        for _, b, one in batches
    ]
    return [head, *rows] if rows else []


def outlier_rows(report: FleetReport) -> Rows:
    """Outlying recordings and the quantities that make them so."""
    head = ("recording", "batch", "distance", "limit", "by")
    rows = [
        (
            name_of(one.recording),
            one.recording.batch or UNKNOWN,
            number(one.distance, 3),
            number(one.limit, 3),
            one.text.removeprefix(f"{name_of(one.recording)}: "),
        )
        for one in report.outliers
    ]
    return [head, *rows] if rows else []


def capability_rows(report: FleetReport) -> Rows:
    """Process capability of each quantity with limits."""
    head = ("quantity", "low", "high", "Cpk", "95 %", "beyond", "share of all, 95 %")
    rows = []
    for one in report.quantities:
        if (index := one.capability) is None:
            continue
        interval = "" if index.cpk_low is None else f"{number(index.cpk_low, 3)} to {number(index.cpk_high, 3)}"
        share = f"{number(100.0 * index.beyond_low, 2)} to {percent(100.0 * index.beyond_high)}"
        limits = (quantity(index.low, one.unit, 4), quantity(index.high, one.unit, 4))
        rows.append((one.label, *limits, number(index.cpk, 3), interval, f"{index.beyond} of {one.count}", share))
    return [head, *rows] if rows else []


def judgement_rows(judgement: FleetJudgement) -> Rows:
    """The recordings that did not pass, and why."""
    head = ("recording", "", "why")
    return [head, *((name_of(o.recording), _JUDGEMENTS[o.judgement], "; ".join(o.reasons)) for o in judgement.others)]


def pair_rows(pairs: FleetPairs) -> Rows:
    """Changes over all pairs."""
    head = ("quantity", "pairs", "after minus before", "95 %", "changed")
    rows = [
        (q.label, str(q.count), *value_and_interval(q.shift, q.low, q.high, q.unit), _yes(q.significant))
        for q in pairs.quantities
    ]
    return [head, *rows] if rows else []


def change_rows(pairs: FleetPairs) -> Rows:
    """Changes of each motor."""
    head = ("motor", "quantity", "before", "after", "difference", "95 %")
    rows = []
    for one in pairs.changes:
        if one.difference is None:
            change = ("appeared" if one.before is None else "disappeared", "")
        else:
            change = value_and_interval(one.difference, one.low, one.high, one.unit)
        ends = (quantity(one.before, one.unit, 4), quantity(one.after, one.unit, 4))
        rows.append((f"serial {one.serial}", one.label, *ends, *change))
    return [head, *rows] if rows else []


def count_rows(report: FleetReport) -> Rows:
    """Numbers of verdicts and of failures."""
    rows = [(plain(one.what), str(one.count)) for one in report.verdicts]
    rows += [(f"failed: {one.what}", str(one.count)) for one in report.failures]
    rows += [("in damaged parts of the table", "not known")] if report.damaged else []
    return [("verdict", "recordings"), *rows]


def prior_rows(priors: FleetPriors) -> Rows:
    """Priors for the next motor."""
    head = ("quantity", "in", "probability", "mean", "between motors", "recordings")
    rows = [
        (label, "", "", *value_and_error(prior.mean, prior.std, prior.unit), str(prior.recordings))
        for label, prior in (("R_s", priors.resistance), ("L_d", priors.d_inductance), ("L_q", priors.q_inductance))
        if prior is not None
    ]
    for name, effect in priors.effects.items():
        share, probability = f"{effect.found} of {effect.asked}", number(effect.probability, 3)
        for parameter, prior in effect.sizes.items():
            size = value_and_error(prior.mean, prior.std, prior.unit)
            label = f"{plain(name)}: {parameter_words(parameter)}"
            rows.append((label, share, probability, *size, str(prior.recordings)))
    return [head, *rows]


SECTIONS: dict[str, Callable[[FleetReport], Rows]] = {
    "Distributions": distribution_rows,
    "Limits": capability_rows,
    "Outliers": outlier_rows,
    "Batches": batch_rows,
    "Over time": course_rows,
}
"""Tables of the report itself, by their titles."""


def name_of(recording: FleetRecording) -> str:
    """A recording's name for people: the motor's serial number, else its name or place."""
    return f"serial {recording.serial}" if recording.serial else recording.name or recording.source


def date(at: object) -> str:
    """A time to the minute."""
    return str(at)[:16]


def _yes(value: bool) -> str:
    return "yes" if value else "no"
