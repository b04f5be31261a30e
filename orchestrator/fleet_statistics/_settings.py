"""From when on something in a fleet is said; every number with its unit and reason."""

from __future__ import annotations

from protocols import Strict, Verdict


class FleetCriteria(Strict):
    """What a fleet's report goes by."""

    chance: float = 0.05
    """Of a false word about a fleet in which nothing is: of any outlier, any drift, any shift, any change of a pair."""
    least_values: int = 8
    """Of a quantity, before its spread, its drift or a batch is told: the interval of a rank is empty below 6."""
    least_relative_spread: float = 1e-6
    """Of a quantity over its own size: what scatters less was typed in or computed, not measured."""
    least_rows_per_coordinate: int = 10
    """Of the robust distance: with fewer, half of the rows do not tell a scatter."""
    widely_known: float = 0.8
    """Share of the recordings that a quantity of the robust distance has to be known of."""
    rare: float = 0.05
    """Share of the diagnosed recordings in which an effect is so seldom that it makes an outlier where it is found."""
    told_share: float = 0.8
    """Of the squared distance: so many quantities are named as its reasons."""
    most_reasons: int = 3
    strange_sigma: float = 3.0
    """Below it, a quantity is strange beside the others rather than by itself."""
    explained: tuple[Verdict, ...] = ("clean", "explained", "mostly_explained")
    """Verdicts of diagnoses whose effects are believed where the next motor is told what to expect."""
    far_out: float = 4.0
    """Robust deviations from the median, beyond which a value is a fault and no property of the kind."""
    most_bins: int = 40
    most_points: int = 400
    """Of a chart in the report: of more recordings, the most extreme of each group are kept."""
    quantiles: tuple[float, ...] = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
