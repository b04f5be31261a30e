"""Thresholds of a fleet's report, each with its unit and reason."""

from __future__ import annotations

from protocols import Strict, Verdict


class FleetCriteria(Strict):
    """Thresholds of a fleet's report."""

    max_false_alarm: float = 0.05
    """Probability of a false alarm in a uniform fleet, for any outlier, any drift, any shift, any change of a pair."""
    min_values: int = 8
    """Values that a quantity's spread, drift or batch shift needs: the interval of a rank is empty below 6."""
    min_relative_spread: float = 1e-6
    """Spread of a quantity over its own size: one that scatters less was typed in or computed, not measured."""
    min_rows_per_quantity: int = 10
    """Rows per quantity of the robust distance: with fewer, half of the rows do not determine a scatter."""
    min_known_share: float = 0.8
    """Share of the recordings that need to have a quantity of the robust distance."""
    max_rare_share: float = 0.05
    """Share of the diagnosed recordings up to which an effect is rare, so that each recording with it is an outlier."""
    explained_share: float = 0.8
    """Share of the squared distance that the quantities named as its reasons make up."""
    max_reasons: int = 3
    """Quantities that are named as reasons."""
    min_outlier_sigma: float = 3.0
    """Deviation below which a quantity is unusual in combination with the others rather than by itself."""
    explained_verdicts: tuple[Verdict, ...] = (
        "clean",
        "explained",
        "explained_in_another_form",
        "mostly_explained",
    )
    """Verdicts of the diagnoses whose effects enter the priors for the next motor."""
    max_robust_sigmas: float = 4.0
    """Robust deviations from the median, beyond which a value is a fault and no property of the kind."""
    max_bins: int = 40
    """Bins of a histogram."""
    max_points: int = 400
    """Points of a chart: of more recordings, the most extreme of each group are kept."""
    quantiles: tuple[float, ...] = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
    """Shares of a quantity's quantiles."""
