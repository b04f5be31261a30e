"""One pass of the estimators over a recording, and its results as files. No physics of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from orchestrator.analysis._checks import difference_percent, flux_ratio, rated_flux_wb
from orchestrator.analysis._heating import temperature_rise
from orchestrator.estimation._flux_map_file import save_flux_map
from orchestrator.recording import replace_file
from orchestrator.recording._recording_checks import SoundRecording
from protocols import (
    Estimate,
    EstimationContext,
    EstimationReport,
    Estimator,
    FluxMapEstimate,
    MapChecks,
    MapReport,
    NotMeasuredError,
    PluginError,
    RecordingReader,
    Remark,
    ResistanceEstimate,
    ResistanceReport,
    StorageError,
)

_REPORT = "estimates.json"
_PREFERRED = ("energy", "injection", "classical")
_TURNS = ("injection", "energy", "polynomial")  # they build on what the others found, and on each other
_ENERGIES = ("energy", "polynomial")
_BAD_ENERGY_PERCENT = 2.0  # rms, off every map of the measurements it was fitted to
_BAD_CROSSINGS_PERCENT = 5.0
_BAD_PARITY_PERCENT = 5.0
_BAD_DIFFERENCE_PERCENT = 10.0
_LEAST_RATIO = 0.01  # of injection's flux to the classical method's, that is worth a word
_SURE = 2.0  # standard deviations


def estimate_recording(
    recording: RecordingReader,
    estimators: Sequence[Estimator],
    out: Path,
    *,
    on_estimate: Callable[[Estimate], None] | None = None,
) -> EstimationReport:
    """Run the estimators and write results/flux_map.nc, flux_map_<method>.nc and estimates.json below `out`.

    These replace the maps and the report of an earlier pass as one set; other files there stay.

    Parameters
    ----------
    recording : RecordingReader
    estimators : sequence of Estimator
        Those of the resistance run first, and the narrowest interval is used; injection's run after the sweeps', an
        energy's run last; each sees what those before it found. A map of an energy that
        explains the measurements is recommended before one by injection, that before a classical one, any other
        after them.
    out : Path
        Directory that gets the folder ``results``.
    on_estimate : callable, optional
        Called with each estimate as soon as it is there.

    Raises
    ------
    NotMeasuredError
        Where nothing at all can be estimated, or currents and voltages cannot be a motor's; no file is written then.
    StorageError
        Where a result cannot be written.
    """
    SoundRecording(recording).read_through()
    resistance: ResistanceEstimate | None = None
    resistances: dict[str, ResistanceEstimate] = {}
    maps: dict[str, FluxMapEstimate] = {}
    missing: list[Remark] = []
    for estimator in sorted(estimators, key=_turn):
        try:
            found = estimator.estimate(recording, EstimationContext(resistance=resistance, maps=dict(maps)))
        except NotMeasuredError as error:
            missing.append(Remark(code="not_measured", text=str(error)).by(estimator.name))
            continue
        if isinstance(found, ResistanceEstimate):
            resistances[estimator.name] = found
            resistance = min(resistances.values(), key=lambda r: r.high - r.low)
        elif isinstance(found, FluxMapEstimate):
            maps[found.map.method] = found
        else:
            raise PluginError(estimator.name, "estimate", f"returned {type(found).__name__} instead of an estimate")
        if on_estimate is not None:
            on_estimate(found)
    if resistance is None and not maps:
        problem = "; ".join(remark.text for remark in missing) or "no estimator was asked"
        raise NotMeasuredError(recording.manifest.name, "", f"nothing can be estimated: {problem}")
    missing += _other_resistances(resistance, resistances)
    report = _report(recording, resistance, maps, missing)
    return _written(report, recording, maps, out / "results")


def _turn(estimator: Estimator) -> tuple[bool, int]:
    """Resistances first, energies last."""
    return estimator.produces != "resistance", _TURNS.index(estimator.name) + 1 if estimator.name in _TURNS else 0


def _other_resistances(
    chosen: ResistanceEstimate | None, resistances: Mapping[str, ResistanceEstimate]
) -> list[Remark]:
    """The one with the narrowest interval is chosen; what the others say is told."""
    text = "R_s = {value_ohm:.4g} ohm (95 %: {low:.4g} to {high:.4g}), a wider interval: not used"
    return [
        Remark.of("wider_interval", text, value_ohm=r.value_ohm, low=r.low, high=r.high).by(name)
        for name, r in resistances.items()
        if r is not chosen
    ]


def _recommended(maps: dict[str, FluxMapEstimate], rated_a: float | None) -> FluxMapEstimate | None:
    order = sorted(maps, key=lambda m: _PREFERRED.index(m) if m in _PREFERRED else len(_PREFERRED))
    if len(order) > 1 and order[0] == "energy" and not _explains(maps, rated_a):
        order = [*order[1:], "energy"]
    return maps[order[0]] if order else None


def _explains(maps: dict[str, FluxMapEstimate], rated_a: float | None) -> bool:
    """Whether an energy agrees with one of the maps at least; one that does is better than any of them alone."""
    energy = maps["energy"].map
    rated = rated_flux_wb(energy, rated_a)
    off = [difference_percent(energy, other.map, rated) for method, other in maps.items() if method not in _ENERGIES]
    known = [one for one in off if one is not None]
    return not known or min(known) <= _BAD_ENERGY_PERCENT


def _report(
    recording: RecordingReader,
    resistance: ResistanceEstimate | None,
    maps: dict[str, FluxMapEstimate],
    missing: list[Remark],
) -> EstimationReport:
    best = _recommended(maps, recording.manifest.motor.rated_current_a)
    checks = best.checks if best else MapChecks()
    difference = _difference(recording, maps)
    against = _objections(best)
    remarks = _remarks(difference, maps)
    unscaled = best is not None and rated_flux_wb(best.map, recording.manifest.motor.rated_current_a) is None
    unscaled_text = "the map does not reach the rated current: no percentages"
    told = [Remark.of("rated_current_not_reached", unscaled_text)] if unscaled else []
    told += [remark.by(method) for method, found in maps.items() for remark in found.remarks]
    return EstimationReport(
        resistance=_resistance_report(resistance) if resistance else None,
        method=best.map.method if best else None,
        crossings=checks.crossings,
        parity=checks.parity,
        reciprocity_percent=checks.reciprocity_percent,
        classical_against_injection_percent=difference,
        usable=best is not None and not against,
        remarks=(*against, *remarks, *missing, *(resistance.remarks if resistance else ()), *told),
        maps={method: MapReport(checks=found.checks, form=found.form) for method, found in maps.items()},
    )


def _resistance_report(found: ResistanceEstimate) -> ResistanceReport:
    return ResistanceReport(
        value_ohm=found.value_ohm,
        low=found.low,
        high=found.high,
        first_ohm=found.first_ohm,
        last_ohm=found.last_ohm,
        temperature_rise_k=temperature_rise(found.readings),
        readings=found.readings,
    )


def _difference(recording: RecordingReader, maps: dict[str, FluxMapEstimate]) -> float | None:
    if not {"classical", "injection"} <= maps.keys():
        return None
    injection, classical = maps["injection"].map, maps["classical"].map
    rated = rated_flux_wb(injection, recording.manifest.motor.rated_current_a)
    return difference_percent(injection, classical, rated)


def _objections(best: FluxMapEstimate | None) -> list[Remark]:
    """What makes the recommended map unusable."""
    if best is None:
        return [Remark.of("no_map", "no flux map could be made")]
    checks, told = best.checks, []
    for axis in ("d", "q"):
        crossing = getattr(checks.crossings, f"{axis}_percent", None)
        if crossing is not None and crossing > _BAD_CROSSINGS_PERCENT:
            text = "where current paths cross, psi_{axis} differs by {apart_percent:.1f} % of the rated flux"
            told.append(Remark.of("bad_crossings", text, axis=axis, apart_percent=crossing))
        parity = getattr(checks.parity, f"{axis}_percent", None)
        if parity is not None and parity > _BAD_PARITY_PERCENT:
            text = (
                "psi_{axis} breaks its symmetry in i_q by {off_percent:.1f} % of the rated flux: "
                "is the rotor angle right?"
            )
            told.append(Remark.of("bad_parity", text, axis=axis, off_percent=parity))
    return told


def _remarks(difference: float | None, maps: dict[str, FluxMapEstimate]) -> list[Remark]:
    """A difference between the methods speaks against one of them, and does not say which."""
    told = []
    if difference is not None and difference > _BAD_DIFFERENCE_PERCENT:
        text = "the classical and the injection map differ by {apart_percent:.1f} % of the rated flux (rms)"
        told.append(Remark.of("methods_differ", text, apart_percent=difference))
    if not {"classical", "injection"} <= maps.keys():
        return told
    ratio = flux_ratio(maps["injection"].map, maps["classical"].map)
    if ratio is not None and abs(ratio[0] - 1.0) > max(_SURE * ratio[1], _LEAST_RATIO):
        less = ratio[0] < 1.0
        cause = "hysteresis, which a small ripple hardly sees?" if less else "an error of the voltage in the sweeps?"
        text = (
            f"injection gives {{apart_percent:.1f}} % {'less' if less else 'more'} flux than the classical "
            f"method, more than their errors explain: {cause}"
        )
        told.append(Remark.of("flux_ratio", text, apart_percent=100 * abs(ratio[0] - 1.0), ratio=ratio[0]))
    return told


def _written(
    report: EstimationReport, recording: RecordingReader, maps: dict[str, FluxMapEstimate], folder: Path
) -> EstimationReport:
    """Replace the results in `folder` as one set: a kill leaves the old one, the new one, or no report."""
    about = {"motor": recording.manifest.motor.name, "recording": recording.manifest.name}
    named = {"flux_map" if m == report.method else f"flux_map_{m}": found.map for m, found in maps.items()}
    files = {**{name: str(folder / f"{name}.nc") for name in named}, "estimates": str(folder / _REPORT)}
    report = report.model_copy(update={"files": files})
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".estimating-", dir=folder) as staging:
            for name, flux_map in named.items():
                save_flux_map(Path(staging) / f"{name}.nc", flux_map, **about)
            # The report goes first and comes last: where it is, all maps are those that it speaks of.
            (folder / _REPORT).unlink(missing_ok=True)
            for old in folder.glob("flux_map*.nc"):
                old.unlink()
            for new in Path(staging).iterdir():
                new.replace(folder / new.name)
    except OSError as error:
        raise StorageError(f"{folder}: cannot be written: {error.strerror or error}") from error
    replace_file(folder / _REPORT, (report.model_dump_json(indent=2) + "\n").encode())
    return report
