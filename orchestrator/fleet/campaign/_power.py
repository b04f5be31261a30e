"""Detection power of a bench from a campaign: the effects that it detects, from which size, and their accuracy."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from protocols import Strict
from protocols.fleet import FleetRow, HiddenEffect
from protocols.fleet_report import CountOf


class PowerRow(Strict):
    """One hidden effect at one size, over runs that differ in noise alone."""

    condition: str
    effect: str
    parameter: str
    size: float
    runs: int
    found: int
    """Runs whose model has the effect, or one indistinguishable from it."""
    named: int
    """Runs in which the diagnosis names it as a cause."""
    low: float
    high: float
    """95 % interval of the detection probability, Wilson's."""
    ratio: float | None
    """Estimated size over the true one, median; null where it was never found by its own name."""
    inside: int | None
    """Runs that found it and whose 95 % interval contains the truth."""


class Smallest(Strict):
    """The smallest detected size of an effect."""

    effect: str
    parameter: str
    size: float | None
    """Null where no size is detected."""
    probability: float | None
    low: float | None


class PowerReport(Strict):
    """The JSON contract of `fluxbench campaign --json`."""

    name: str
    table: str
    runs: int
    failed: int
    failures: tuple[CountOf, ...]
    """Errors, the most frequent first."""
    rows: tuple[PowerRow, ...]
    smallest: tuple[Smallest, ...]
    """The size of each effect from which all larger ones are detected too."""
    false_names: int
    """Runs that name an effect that was neither hidden nor indistinguishable from a hidden one."""
    judged: int
    """Runs with a diagnosis."""


def power_of(rows: Sequence[FleetRow], *, name: str, table: str, found_with: float) -> PowerReport:
    """The figures of a campaign's rows.

    Parameters
    ----------
    found_with : float
        Share of its runs from which a size counts as detected.
    """
    failures = Counter(row.failed for row in rows if row.failed is not None)
    judged = [row for row in rows if row.hidden is not None and row.effects is not None]
    groups: dict[tuple[str, str], list[FleetRow]] = {}
    for row in judged:
        for truth in _swept(row.hidden or ()):
            groups.setdefault((row.condition or "", truth.name), []).append(row)
    power_rows = (_row(effect, condition, group) for (condition, effect), group in groups.items())
    power = tuple(sorted(power_rows, key=lambda row: (row.effect, abs(row.size), row.condition)))
    return PowerReport(
        name=name,
        table=table,
        runs=len(rows),
        failed=failures.total(),
        failures=tuple(CountOf(what=what, count=count) for what, count in failures.most_common()),
        rows=power,
        smallest=tuple(_smallest(power, found_with)),
        false_names=sum(map(_has_false_name, judged)),
        judged=len(judged),
    )


def _swept(hidden: Iterable[HiddenEffect]) -> list[HiddenEffect]:
    """The first parameter of each effect, which defines its size."""
    first: dict[str, HiddenEffect] = {}
    for truth in hidden:
        first.setdefault(truth.name, truth)
    return list(first.values())


def _row(effect: str, condition: str, rows: Sequence[FleetRow]) -> PowerRow:
    truth = next(t for t in _swept(rows[0].hidden or ()) if t.name == effect)
    matches = [[e for e in row.effects or () if effect in {e.name, *e.twins}] for row in rows]
    found, named = sum(map(bool, matches)), sum(any(e.material is not False for e in hits) for hits in matches)
    own = [e for hits in matches for e in hits if e.name == effect and e.parameter == truth.parameter]
    sized = [e.size / truth.size for e in own if e.size is not None and truth.size]
    bounded = [e.low <= truth.size <= e.high for e in own if e.low is not None and e.high is not None]
    low, high = wilson(found, len(rows))
    return PowerRow(
        condition=condition,
        effect=effect,
        parameter=truth.parameter,
        size=truth.size,
        runs=len(rows),
        found=found,
        named=named,
        low=low,
        high=high,
        ratio=float(np.median(sized)) if sized else None,
        inside=sum(bounded) if bounded else None,
    )


def _has_false_name(row: FleetRow) -> bool:
    hidden = {truth.name for truth in row.hidden or ()}
    return any(e.material is not False and not hidden & {e.name, *e.twins} for e in row.effects or ())


def _smallest(power: Sequence[PowerRow], found_with: float) -> Iterable[Smallest]:
    for effect, parameter in dict.fromkeys((row.effect, row.parameter) for row in power):
        mine = [row for row in power if (row.effect, row.parameter) == (effect, parameter)]
        best: Smallest | None = None
        for size in sorted({row.size for row in mine}, key=abs, reverse=True):
            there = [row for row in mine if row.size == size]
            runs, found = sum(row.runs for row in there), sum(row.found for row in there)
            if found / runs < found_with:
                break
            best = Smallest(
                effect=effect, parameter=parameter, size=size, probability=found / runs, low=wilson(found, runs)[0]
            )
        yield best or Smallest(effect=effect, parameter=parameter, size=None, probability=None, low=None)


def wilson(hits: int, count: int, sigmas: float = 1.96) -> tuple[float, float]:
    """95 % interval of a probability (doi:10.1080/01621459.1927.10502953)."""
    if not count:
        return 0.0, 1.0
    share, scale = hits / count, sigmas**2 / count
    middle = (share + 0.5 * scale) / (1.0 + scale)
    half = sigmas / (1.0 + scale) * math.sqrt(share * (1.0 - share) / count + 0.25 * scale / count)
    return max(0.0, middle - half), min(1.0, middle + half)
