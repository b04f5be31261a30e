"""What an estimation and a diagnosis found, as rows of text: alike in a terminal's tables, on the page, the viewer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from orchestrator.formatting.names import parameter_words, plain, rung_name, symbol_of
from orchestrator.formatting.quantities import (
    UNKNOWN,
    Scale,
    axes_percent,
    measured,
    number,
    percent,
    plural,
    quantity,
    value_and_error,
    value_and_interval,
)
from orchestrator.formatting.sentences import listed
from protocols import (
    Basis,
    CheckOutcome,
    ClosedForm,
    DiagnosisReport,
    DiagnosisStep,
    EstimationReport,
    EstimatorsReport,
    FoundEffect,
    ResistanceEstimate,
    Rung,
    UsabilityCheck,
)


def resistance(found: ResistanceEstimate) -> str:
    """R_s with its 95 % interval."""
    return measured(found.value_ohm, found.low, found.high, "ohm")


def resistance_course(found: ResistanceEstimate) -> str:
    """R_s at both ends of the recording, to the digits that R_s itself bears."""
    scale = Scale.of(found.value_ohm, found.low, found.high, "ohm")
    return f"{scale.quantity(found.first_ohm)} at the start, {scale.quantity(found.last_ohm)} at the end"


def check_rows(report: EstimationReport) -> Iterator[tuple[str, str]]:
    """The recommended map's checks, and how the two methods compare; an energy's map holds two by construction."""
    made = report.recommended
    by = " (by construction)" if made is not None and made.basis is Basis.ENERGY else ""
    for label, told, beside in (
        ("crossings", axes_percent(report.crossings), ""),
        ("parity", axes_percent(report.parity), by),
        ("reciprocity", percent(report.reciprocity_percent), by),
        ("classical against injection", percent(report.classical_against_injection_percent), ""),
    ):
        yield label, told if told == UNKNOWN else told + beside


def usability_rows(report: EstimatorsReport) -> list[tuple[str, str, str, str]]:
    """Checks that decide whether a map is usable: name, what was found, largest that passes, outcome."""
    return [(plain(check.name), *_value_and_limit(check), _outcome_words(check)) for check in report.checks]


def _value_and_limit(check: UsabilityCheck) -> tuple[str, str]:
    value, limit = (
        UNKNOWN if x is None else percent(x) if check.unit == "%" else number(x) for x in (check.value, check.limit)
    )
    return value, limit


def _outcome_words(check: UsabilityCheck) -> str:
    if check.outcome is CheckOutcome.NOT_POSSIBLE:
        return "could not be made" + ("" if check.required else ", not required")
    return plain(check.outcome)


def coefficient_rows(form: ClosedForm) -> list[tuple[str, ...]]:
    """A formula's coefficients: symbol, value, standard deviation."""
    return [(symbol_of(c.name), *value_and_error(c.value, c.std, c.unit)) for c in form.coefficients]


def ladder_rows(ladder: Sequence[Rung | DiagnosisStep]) -> list[tuple[str, ...]]:
    """Rungs of the ladder: what was added, chi2, rms error fitted and held out, error of the simulated current."""
    return [
        (
            rung_name(rung.added, k),
            number(rung.chi2),
            quantity(rung.rms_v, "V"),
            quantity(rung.heldout_rms_v, "V"),
            quantity(rung.current_rms_a, "A"),
        )
        for k, rung in enumerate(ladder)
    ]


def parameter_rows(effect: FoundEffect) -> list[tuple[str, str, str]]:
    """An effect's parameters and what follows from them for the drive: name, value, 95 % interval.

    What only bends its form is counted, not listed.
    """
    sizes = {name: found for name, found in effect.parameters.items() if not found.bends_form}
    rows = [
        (parameter_words(name), *value_and_interval(found.value, found.low, found.high, found.unit))
        for name, found in {**sizes, **effect.derived}.items()
    ]
    bends = len(effect.parameters) - len(sizes)
    return [*rows, ("its form", f"{plural(bends, 'more number')} in model.json", "")] if bends else rows


def share_rows(effects: Sequence[FoundEffect]) -> list[tuple[str, ...]]:
    """Effects by what they do: name, size over the typical one, part of the error, probability, material or not."""
    return [
        (
            plain(effect.name),
            number(effect.relative_size),
            percent(None if effect.share is None else 100.0 * effect.share),
            percent(None if effect.probability is None else 100.0 * effect.probability, 4),
            {None: UNKNOWN, True: "yes", False: "no"}[effect.material],
        )
        for effect in effects
    ]


def share_notes(report: DiagnosisReport) -> list[str]:
    """What `share_rows` leave open: parts above 100 %, and causes that are not material."""
    notes = []
    if any((effect.share or 0.0) > 1.0 for effect in (*report.effects, *report.minor)):
        notes.append(
            "above 100 % of the error: without this effect the model would err more than the first model did, whose "
            "R_s and map had made up for a part of it"
        )
    small = [plain(effect.name) for effect in report.effects if effect.material is False]
    if small and report.materiality is not None:
        flux, volts = percent(report.materiality.flux_percent), percent(report.materiality.voltage_percent)
        notes.append(
            f"{listed(small)}: a cause of the error that was measured, but not material: it changes the map by less "
            f"than {flux} of the rated flux, and the voltage by less than {volts} of the excitation's"
        )
    return notes


def setting_rows(stage: Mapping[str, object]) -> list[tuple[str, str]]:
    """A proposed stage's settings, those that are given."""
    return [(plain(name), str(value)) for name, value in stage.items() if value is not None]
