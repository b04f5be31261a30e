"""The numbers that a list of runs shows and a station judges, read from a run's ``results/`` without its samples."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from orchestrator.validation.plain_files import read_bytes
from protocols import FluxMap, Interval, Lenient, Number, RecordingError, Usability, Verdict

DIAGNOSIS = Path("results", "diagnosis.json")
_SIGMAS_95 = 1.96
"""Standard deviations in half of a 95 % interval."""


class _Cause(Lenient):
    name: str


class _Report(Lenient):
    verdict: Verdict
    effects: tuple[_Cause, ...]
    map_error_percent: Number = None


class _DiagnosisFile(Lenient):
    report: _Report


@dataclass(frozen=True)
class RunResults:
    """Results of one run.

    Attributes
    ----------
    quantities : mapping of str to Interval
        R_s, inductances at zero current, rated flux and the map's error, by their names with units:
        ``resistance_ohm``, ``l_dd_h``, ``l_qq_h``, ``rated_flux_wb``, ``map_error_percent``. Those not measured are
        missing.
    usability : Usability or None
        Of the map; None without estimates.
    verdict : Verdict or None
        None: not diagnosed.
    causes : tuple of str
        The effects that the diagnosis reports.
    """

    quantities: Mapping[str, Interval] = field(default_factory=dict)
    usability: Usability | None = None
    verdict: Verdict | None = None
    causes: tuple[str, ...] = ()


def load_results(folder: Path, rated_current_a: float | None) -> RunResults:
    """The results in a run's folder; raises `RecordingError` for a damaged file.

    Parameters
    ----------
    folder : Path
        The run.
    rated_current_a : float, optional
        Peak, as the nameplate has it; without it there is no rated flux.
    """
    # A list of runs that are indexed already needs no estimators.
    from orchestrator.estimation import RECOMMENDED_MAP, has_estimates, load_estimates, load_own_flux_map

    quantities: dict[str, Interval] = {}
    usability = None
    if has_estimates(folder):
        estimates = load_estimates(folder)
        usability, r_s = estimates.usability, estimates.resistance
        if r_s is not None:
            interval = Interval(value=r_s.value_ohm, low=r_s.low, high=r_s.high, unit="ohm")
            quantities["resistance_ohm"] = interval
        if estimates.method is not None:
            quantities |= _of_map(load_own_flux_map(folder / RECOMMENDED_MAP), rated_current_a)
    diagnosis = _load_diagnosis(folder / DIAGNOSIS)
    if diagnosis is None:
        return RunResults(quantities, usability)
    error = diagnosis.map_error_percent
    if error is not None:
        quantities["map_error_percent"] = Interval(value=error, low=error, high=error, unit="%")
    causes = tuple(effect.name for effect in diagnosis.effects)
    return RunResults(quantities, usability, diagnosis.verdict, causes)


def _load_diagnosis(file: Path) -> _Report | None:
    try:
        return _DiagnosisFile.model_validate_json(read_bytes(file)).report
    except FileNotFoundError:
        return None
    except OSError as error:
        raise RecordingError(str(file), "", f"cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        raise RecordingError(str(file), ".".join(map(str, first["loc"])), str(first["msg"])) from None


def _of_map(flux_map: FluxMap, rated_current_a: float | None) -> Iterator[tuple[str, Interval]]:
    from orchestrator.analysis import rated_flux_wb, values_at

    at_rest = values_at(flux_map, "l_dd", "l_dd_std", "l_qq", "l_qq_std")(np.zeros((1, 2)))[0]
    for name, value, std in (("l_dd_h", *at_rest[:2]), ("l_qq_h", *at_rest[2:])):
        if np.isfinite(value):
            yield name, _interval(value, std, "H")
    flux = rated_flux_wb(flux_map, rated_current_a)
    if flux is not None and rated_current_a is not None:
        sides = np.array([[0.0, rated_current_a], [0.0, -rated_current_a]])
        stds = values_at(flux_map, "psi_q_std")(sides)
        # The mean of both sides, whose errors are not independent.
        yield "rated_flux_wb", _interval(flux, float(np.nanmean(stds)) if np.isfinite(stds).any() else np.nan, "Wb")


def _interval(value: float, std: float, unit: str) -> Interval:
    half = _SIGMAS_95 * float(std) if np.isfinite(std) else 0.0
    return Interval(value=float(value), low=float(value) - half, high=float(value) + half, unit=unit)
