"""What a fleet's table tells, as `fluxbench fleet report` prints and draws it; and the limits that people set for it.

Every number is finite or null, in the unit that its quantity's name ends with.
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import AwareDatetime, Field, model_validator

from protocols._base import Lenient, Strict
from protocols._remarks import Number, Remark
from protocols._verdict import Verdict

Judgement = Literal["pass", "fail", "unsure", "not_measured"]


class FleetLimit(Strict):
    """Between which values a quantity has to be; one of them may be left out."""

    low: float | None = None
    high: float | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low is None and self.high is None:
            raise ValueError("expected low, high or both")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"low {self.low:g} is above high {self.high:g}")
        return self


class FleetLimits(Strict):
    """A file of limits for a motor's quantities."""

    quantities: dict[str, FleetLimit] = Field(default_factory=dict)
    """By the table's names (``R_s_ohm``), and EFFECT.PARAMETER (``dead_time.voltage_v``)."""
    verdicts: tuple[Verdict, ...] | None = None
    """Verdicts of a diagnosis that pass; by default any."""
    usable: bool = False
    """Whether the map has to be one to rely on."""
    guard: bool = True
    """Whether a value whose 95 % interval holds a limit is unsure; else the value alone decides."""


class FleetRecording(Lenient):
    """Which recording."""

    source: str
    name: str | None
    serial: str | None
    batch: str | None
    started_at: AwareDatetime | None


class Quantile(Lenient):
    """A value that this share of the recordings does not exceed."""

    share: float
    value: float


class Histogram(Lenient):
    """Histogram of the values; outliers are counted in the end bins."""

    edges: tuple[float, ...]
    counts: tuple[int, ...]


class Drift(Lenient):
    """A quantity's change a day: the median of all pairs' slopes, with its 95 % interval."""

    per_day: float
    low: float
    high: float
    chance: float
    """Probability of a trend this clear by chance (Kendall), before the correction for the number of tests."""
    drifts: bool
    """Whether the trend is significant among all tested quantities (Holm, 5 %)."""


class BatchShift(Lenient):
    """Difference of a batch from all others, with its 95 % interval."""

    batch: str
    count: int
    middle: float
    shift: float
    low: float
    high: float
    chance: float
    shifted: bool
    """Whether the difference is significant among all tested batches and quantities (Holm, 5 %)."""


class ChartPoint(Lenient):
    """One place of a control chart: a recording, or the most extreme average of several that follow each other."""

    at: AwareDatetime
    value: float
    """Median, where there are several."""
    average: float
    lower: float
    upper: float


class ControlChart(Lenient):
    """The moving average over time and the limits that it keeps while nothing moves."""

    target: float
    deviation: float
    weight: float
    width: float
    beyond: int
    """Recordings at which the average is beyond its limits."""
    first_beyond: AwareDatetime | None
    points: tuple[ChartPoint, ...]


class CapabilityIndex(Lenient):
    """Cpk with its 95 % interval, and what share is beyond the limits."""

    low: float | None
    """Limit; likewise high."""
    high: float | None
    cpk: Number
    cpk_low: Number
    cpk_high: Number
    beyond: int
    beyond_low: float
    """95 % interval of the share beyond, whatever the distribution."""
    beyond_high: float


class FleetQuantity(Lenient):
    """One quantity over the whole table."""

    name: str
    label: str
    unit: str
    count: int
    """Recordings that have it."""
    asked: int
    """Recordings that could have it: with results, or a diagnosis."""
    of_motor: bool
    """Whether it belongs to the motor rather than to the measurement, and follows from no other quantity."""
    middle: Number
    spread: Number
    """1.4826 times the median distance from the middle."""
    typical_interval: Number
    """Median half width of the recordings' own 95 % intervals."""
    quantiles: tuple[Quantile, ...]
    histogram: Histogram | None
    drift: Drift | None = None
    batches: tuple[BatchShift, ...] = ()
    chart: ControlChart | None = None
    capability: CapabilityIndex | None = None


class OutlierReason(Lenient):
    """A quantity that makes a recording an outlier."""

    quantity: str
    label: str
    value: Number
    unit: str
    sigma: Number
    """Robust standard deviations from the middle; null of an effect that is hardly ever there."""
    share: Number
    """Part of the squared distance; null where the quantity was examined alone."""
    found_in: int | None = None
    """Number of recordings with the effect, where it is hardly ever there."""
    sure: bool | None = None
    """Whether the recording's own 95 % interval leaves out the fleet's middle; null where it has none."""


class FleetOutlier(Lenient):
    """A recording unlike the others."""

    recording: FleetRecording
    distance: Number
    """Robust distance; null where it is not by this that it was found."""
    limit: Number
    """Distance that no recording of a clean fleet of this size exceeds, 95 times of 100."""
    reasons: tuple[OutlierReason, ...]
    text: str


class DistancePoint(Lenient):
    """A recording's robust distance over its limit; of a large fleet all outliers and some others."""

    recording: int
    ratio: float


class Distances(Lenient):
    """What the robust distance was taken of."""

    quantities: tuple[str, ...]
    counted: int
    """Recordings that middle and scatter are made of."""
    points: tuple[DistancePoint, ...]


class NotPassed(Lenient):
    """A recording that failed, or whose interval includes the limit."""

    recording: FleetRecording
    judgement: Judgement
    reasons: tuple[str, ...]


class FleetJudgement(Lenient):
    """The fleet against its limits."""

    limits: FleetLimits
    passed: int
    failed: int
    unsure: int
    not_measured: int
    others: tuple[NotPassed, ...]
    """Failed limits."""


class PairChange(Lenient):
    """A quantity of one motor before and after."""

    serial: str
    quantity: str
    label: str
    unit: str
    before: Number
    after: Number
    difference: Number
    low: Number
    """95 % interval of the difference, from both own intervals; null where one has none."""
    high: Number
    significant: bool
    """Significant among all tested differences (Holm, 5 %), or an effect that appeared or disappeared."""


class PairedQuantity(Lenient):
    """A quantity's change over all pairs."""

    name: str
    label: str
    unit: str
    count: int
    shift: float
    low: float
    high: float
    chance: float
    significant: bool


class FleetPairs(Lenient):
    """Motors measured twice."""

    against: str
    count: int
    unpaired: int
    """Serial numbers with one of the two alone."""
    quantities: tuple[PairedQuantity, ...]
    changes: tuple[PairChange, ...]
    """The significant ones."""


class CountOf(Lenient):
    """Count."""

    what: str
    count: int


class FleetReport(Lenient):
    """Statistics of a fleet's table; the page shows exactly these."""

    table: str
    recordings: int
    serials: int
    first: AwareDatetime | None
    last: AwareDatetime | None
    verdicts: tuple[CountOf, ...]
    failures: tuple[CountOf, ...]
    """Recordings without results, by what went wrong."""
    damaged: tuple[str, ...] = ()
    """Parts of the table that cannot be read, each with its problem; their recordings are missing here."""
    quantities: tuple[FleetQuantity, ...]
    distances: Distances | None
    outliers: tuple[FleetOutlier, ...]
    judgement: FleetJudgement | None = None
    pairs: FleetPairs | None = None
    remarks: tuple[Remark, ...] = ()
