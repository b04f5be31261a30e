"""Statistical process control: capability, and control charts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array, Mask


@dataclass(frozen=True)
class Capability:
    """Cpk with its 95 % interval."""

    value: float
    low: float
    high: float


def capability(values: Array, lower: float | None, upper: float | None) -> Capability | None:
    """Distance of the mean from the nearer limit over three standard deviations; None where no two values differ.

    The interval is Bissell's (Applied Statistics 39 (1990) 331-340): Cpk +- 1.96 sqrt(1/(9 n) + Cpk^2 / (2 (n - 1))).
    The standard deviation is the whole sample's, which some call Ppk.
    """
    count = len(values)
    spread = float(np.std(values, ddof=1)) if count > 1 else 0.0
    ends = [(upper - float(np.mean(values))) if upper is not None else math.inf]
    ends.append((float(np.mean(values)) - lower) if lower is not None else math.inf)
    if not spread > 0.0 or math.isinf(min(ends)):
        return None
    value = min(ends) / (3.0 * spread)
    half = _two_sigma() * math.sqrt(1.0 / (9.0 * count) + value**2 / (2.0 * (count - 1)))
    return Capability(value, value - half, value + half)


@dataclass(frozen=True)
class EwmaSettings:
    """Settings of a control chart.

    Attributes
    ----------
    weight : float
        Weight of the newest value.
    width : float
        Width of the limits, in standard deviations. With 0.2 and 2.962 one false alarm in 500 values (Lucas and
        Saccucci 1990, doi:10.1080/00401706.1990.10484583).
    """

    weight: float = 0.2
    width: float = 2.962


@dataclass(frozen=True)
class EwmaChart:
    """An exponentially weighted moving average and its limits, in temporal order.

    Attributes
    ----------
    average, lower, upper : array, shape (n,)
    beyond : array of bool, shape (n,)
    """

    average: Array
    lower: Array
    upper: Array

    @property
    def beyond(self) -> Mask:
        return (self.average < self.lower) | (self.average > self.upper)


def ewma(values: Array, target: float, deviation: float, settings: EwmaSettings | None = None) -> EwmaChart:
    """z_k = w x_k + (1 - w) z_k-1 starting at the target, with limits that widen with k.

    Roberts 1959, doi:10.1080/00401706.1959.10489860.
    """
    from scipy.signal import lfilter

    settings = settings or EwmaSettings()
    w = settings.weight
    average = lfilter([w], [1.0, w - 1.0], values, zi=[(1.0 - w) * target])[0]
    grown = 1.0 - (1.0 - w) ** (2.0 * np.arange(1, len(values) + 1))
    half = settings.width * deviation * np.sqrt(w / (2.0 - w) * grown)
    return EwmaChart(np.asarray(average, dtype=np.float64), target - half, target + half)


def deviation_between_neighbours(values: Array) -> float:
    """Standard deviation from the median step between successive values, which slow drift does not increase."""
    from scipy.stats import norm

    steps = np.abs(np.diff(values))
    return float(np.median(steps) / (math.sqrt(2.0) * norm.ppf(0.75))) if len(steps) else 0.0


def share_beyond(beyond: int, count: int) -> tuple[float, float]:
    """95 % interval of a population's share beyond a limit, from a sample's count.

    Clopper and Pearson 1934, doi:10.1093/biomet/26.4.404.
    """
    from scipy.stats import beta

    low = float(beta.ppf(0.025, beyond, count - beyond + 1)) if beyond else 0.0
    high = float(beta.ppf(0.975, beyond + 1, count - beyond)) if beyond < count else 1.0
    return low, high


def _two_sigma() -> float:
    from scipy.stats import norm

    return float(norm.ppf(0.975))
