"""The results of one run: R_s, map and effects with their 95 % intervals. Compares nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from orchestrator.diagnosis import SavedDiagnosis, load_diagnosis
from orchestrator.estimation import RECOMMENDED_MAP, load_estimates, load_flux_map
from orchestrator.flux_maps import MapSurface
from orchestrator.numerics.types import Array
from orchestrator.runs import open_any
from protocols import EstimationReport, FluxMap, FoundEffect, Interval, Manifest, ParameterValue

_HALF_INTERVAL_SIGMAS = 1.96
"""Standard deviations in half of a 95 % interval."""


@dataclass(frozen=True)
class RunSummary:
    """The results of a run or recording with estimates, and perhaps a diagnosis."""

    path: Path
    manifest: Manifest
    estimates: EstimationReport
    flux_map: FluxMap | None
    diagnosis: SavedDiagnosis | None

    @classmethod
    def of(cls, path: Path) -> RunSummary:
        """The results in a folder; raises `RecordingError` where there are no estimates, or a file is damaged."""
        manifest, estimates = open_any(path).manifest, load_estimates(path)
        flux_map = load_flux_map(path / RECOMMENDED_MAP) if estimates.method is not None else None
        return cls(path, manifest, estimates, flux_map, load_diagnosis(path))

    @cached_property
    def surface(self) -> MapSurface | None:
        return None if self.flux_map is None else MapSurface(self.flux_map)

    def resistance(self) -> Interval | None:
        """R_s with its interval; None where unknown."""
        r_s = self.estimates.resistance
        return None if r_s is None else Interval(value=r_s.value_ohm, low=r_s.low, high=r_s.high, unit="ohm")

    @property
    def all_effects(self) -> tuple[FoundEffect, ...]:
        """The effects of the diagnosis."""
        return () if self.diagnosis is None else (*self.diagnosis.report.effects, *self.diagnosis.report.minor)

    def effects(self, named: Mapping[str, str]) -> dict[tuple[str, str], Interval | None]:
        """Size of each effect, by its name (or the one in `named`) and parameter; None without an interval.

        Sizes are its first parameter, and those in the same unit.
        """
        out: dict[tuple[str, str], Interval | None] = {}
        for effect in self.all_effects:
            unit = next((p.unit for p in effect.parameters.values()), "")
            for name, p in effect.parameters.items():
                if p.unit == unit:
                    out[named.get(effect.name, effect.name), name] = _known_interval(p)
        return out

    def twins_of(self, first: RunSummary) -> dict[str, str]:
        """Effects of this run that the first run has under another name, indistinguishable in one of both."""
        there = {effect.name: effect for effect in first.all_effects}
        here = {effect.name for effect in self.all_effects}
        return {
            effect.name: name
            for effect in self.all_effects
            for name, other in there.items()
            if effect.name not in there and name not in here and (name in effect.twins or effect.name in other.twins)
        }

    def map_values(self, at: Array) -> Iterator[tuple[str, Interval | None]]:
        """Inductances, and the flux relative to zero current, at (i_d, i_q); None where they were not measured."""
        surface, flux_map = self.surface, self.flux_map
        known = surface is not None and flux_map is not None and bool(surface.inside(at[None])[0])
        for name, unit in (("l_dd", "H"), ("l_dq", "H"), ("l_qq", "H"), ("psi_d", "Wb"), ("psi_q", "Wb")):
            if not known or surface is None or flux_map is None:
                yield name, None
                continue
            if unit == "Wb":
                value = float((surface.psi(at[None]) - surface.psi(np.zeros((1, 2))))[0, int(name == "psi_q")])
            else:
                value = _value_at(flux_map, name, at)
            yield name, _interval(value, _value_at(flux_map, f"{name}_std", at), unit)


def spread_of(flux_map: FluxMap, at: Array) -> Array:
    """Standard deviation of the map's flux at places (n, 2), root of both axes' squares; NaN where unknown."""
    return np.hypot(*(_values_at(flux_map, name, at) for name in ("psi_d_std", "psi_q_std")))


def _known_interval(p: ParameterValue) -> Interval | None:
    if p.value is None or p.low is None or p.high is None:
        return None
    return Interval(value=p.value, low=p.low, high=p.high, unit=p.unit)


def _interval(value: float, std: float, unit: str) -> Interval | None:
    if not np.isfinite(value):
        return None
    half = _HALF_INTERVAL_SIGMAS * std if np.isfinite(std) else 0.0
    return Interval(value=value, low=value - half, high=value + half, unit=unit)


def _value_at(flux_map: FluxMap, name: str, at: Array) -> float:
    return float(_values_at(flux_map, name, at[None])[0])


def _values_at(flux_map: FluxMap, name: str, at: Array) -> Array:
    from scipy.interpolate import RegularGridInterpolator

    axes = (np.asarray(flux_map.i_d, dtype=np.float64), np.asarray(flux_map.i_q, dtype=np.float64))
    table = np.asarray(getattr(flux_map, name), dtype=np.float64)
    values = RegularGridInterpolator(axes, table, bounds_error=False)(at)
    # A point on a measured node next to an unmeasured one takes that node's value.
    nearest = RegularGridInterpolator(axes, table, method="nearest", bounds_error=False)(at)
    return np.asarray(np.where(np.isfinite(values), values, nearest), dtype=np.float64)
