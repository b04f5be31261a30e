"""Results of an estimation and a diagnosis as rows of text, for terminal, page and viewer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from orchestrator.formatting.names import parameter_words, plain, rung_name, symbol_of
from orchestrator.formatting.quantities import (
    UNKNOWN,
    Scale,
    axes_percent,
    duration,
    measured,
    number,
    percent,
    probability,
    quantity,
    value_and_error,
    value_and_interval,
)
from orchestrator.formatting.sentences import listed, typographic
from protocols import (
    Basis,
    CheckOutcome,
    ClosedForm,
    DiagnosisReport,
    DiagnosisStep,
    EffectBasis,
    EstimationReport,
    EstimatorsReport,
    FoundEffect,
    JointEntry,
    ParameterValue,
    Remark,
    ResistanceEstimate,
    Rung,
    SegmentStage,
    Usability,
    UsabilityCheck,
)

CHI2_MEANING = (
    "chi2 is the squared error over the noise's variance: 1 is noise alone. Slow errors weigh most in it, because the "
    "noise averages out over their many samples."
)
CHI2_OF_NOISE_MEANING = (
    "Noise up to: the chi2 that noise alone exceeds once in a thousand. It is large where few values were measured."
)
NOISE_FLOOR_MEANING = (
    "A noise floor is the rms error that the noise of the readings alone would leave; it is averaged over the same "
    "samples as the error beside it."
)
PART_MEANING = (
    "error without it: rms change of the residual where the effect is left out and R_s and the map are refitted, over "
    "the first model's error; both are of one kind of stage, that in which it is largest. So the parts do not add up "
    "to 100 %, and `remove`, over all stages, prints another error"
)
PROBABILITY_MEANING = (
    "probability: that the effect acts, given the others of the model; where another one fits as well in its place, "
    "that either of them does"
)
_KINDS = {
    SegmentStage.RESISTANCE.value: "holds",
    SegmentStage.CLASSICAL.value: "sweeps",
    SegmentStage.INJECTION.value: "means under injection",
}
"""Kinds of rows of a recording, by the stage; those that are missing have the stage's name."""
STAND_IN = (
    "probability and material are of these effects if nothing else acts; something unknown does, and may be what they "
    "take up"
)
"""How to read effects of a model that leaves most of the error."""
REFIT_MEANING = (
    "chi2 differs from that of the same effects in the diagnosis: `add` and `remove` keep the map grid and the "
    "effects' forms that the whole model had, a diagnosis chooses them at each step"
)
MIN_CHI2_RATIO_TO_NOTE: float = 1.1
"""Ratio of two values of chi2 of the same effects from which a refit says why they differ."""
UNDONE_BY = {
    "helps": None, "helps_at_bound": None, "helps_besides": "remove", "does_not_help": "remove",
    "certain": None, "undetermined": "remove",
    "needed": "add", "not_needed": None,
}  # fmt: skip
"""Codes of remarks on whether an effect helps, each with the command that undoes the change, if advised."""
BENEFITS = frozenset(UNDONE_BY)
USABILITY_WORDS = {
    Usability.USABLE: "usable", Usability.NOT_USABLE: "not reliable", Usability.NOT_JUDGED: "not judged"
}  # fmt: skip
UNCHANGED = "unchanged over the recording"
_ENDS = ["in the first segment", "in the last"]


BEYOND_A_RUN = "your sensors' gain and the bus voltage's error, which no run shows, come on top"
"""What adds to the error of a map and of R_s, in words."""


def resistance(estimate: ResistanceEstimate) -> str:
    """R_s with its 95 % interval."""
    return measured(estimate.value_ohm, estimate.low, estimate.high, "ohm")


def resistance_course(estimate: ResistanceEstimate) -> str:
    """R_s at the first and the last reading, with the digits of R_s itself; a model has no readings, but segments.

    Where both are the same in these digits, and in four, it is unchanged.
    """
    scale = Scale.of(estimate.value_ohm, estimate.low, estimate.high, "ohm")
    first, last = ((scale.quantity(r), quantity(r, "ohm", 4)) for r in (estimate.first_ohm, estimate.last_ohm))
    if first == last:
        return UNCHANGED
    is_read = bool(estimate.readings) and not estimate.is_of_model
    ends = [f"at {duration(estimate.readings[k].start_s)}" for k in (0, -1)] if is_read else _ENDS
    return ", ".join(
        f"{scale.quantity(r)} {at}" for r, at in zip((estimate.first_ohm, estimate.last_ohm), ends, strict=True)
    )


def accuracy_words(report: EstimatorsReport) -> str:
    """What a usable map and its R_s are worth: by noise, by how far methods agree, and beyond that; empty otherwise."""
    if not report.usable:
        return ""
    bands = [check.value for check in report.checks if check.name == "flux_band" and check.value is not None]
    parts = [f"the map ±{percent(bands[0])} of the rated flux (rms over the map)"] if bands else []
    if (known := report.resistance) is not None and known.value_ohm > 0.0:
        drifts = not known.is_of_model and resistance_course(known) != UNCHANGED
        mean = f", as the mean over its change ({resistance_course(known)})" if drifts else ""
        parts.append(f"R_s ±{percent(50.0 * (known.high - known.low) / known.value_ohm)}{mean}")
    if not parts:
        return ""
    each = "each " if len(parts) > 1 else ""
    sentences = [f"{' and '.join(parts)}, {each}95 % and of the readings' noise alone"]
    if (apart := report.classical_against_injection_percent) is not None:
        methods = "two independent methods, sweeps and injection, differ by"
        sentences.append(f"{methods} {percent(apart)} of the rated flux (rms)")
    return "; ".join([*sentences, BEYOND_A_RUN])


def check_rows(report: EstimationReport) -> Iterator[tuple[str, str]]:
    """The recommended map's checks, and the methods' difference; an energy's map passes two by construction."""
    recommended = report.recommended
    by = " (by construction)" if recommended is not None and recommended.basis is Basis.ENERGY else ""
    for label, text, suffix in (
        ("crossings", axes_percent(report.crossings), ""),
        ("parity", axes_percent(report.parity), by),
        ("reciprocity", percent(report.reciprocity_percent), by),
        ("classical against injection", percent(report.classical_against_injection_percent), ""),
    ):
        yield label, text if text == UNKNOWN else text + suffix


def has_other_chi2(ladder: Sequence[Rung], diagnosed: Sequence[Rung]) -> bool:
    """Whether a refit's chi2 differs from the diagnosis' for the same effects."""
    known = {frozenset(rung.effects): rung.chi2 for rung in diagnosed}
    pairs = [(rung.chi2, known.get(frozenset(rung.effects))) for rung in ladder]
    return any(a and b and max(a / b, b / a) > MIN_CHI2_RATIO_TO_NOTE for a, b in pairs)


def usability_rows(report: EstimatorsReport) -> list[tuple[str, str, str, str]]:
    """Checks that decide whether a map is usable: name, value, limit, outcome."""
    return [(plain(check.name), *_value_and_limit(check), _outcome_words(check)) for check in report.checks]


def _value_and_limit(check: UsabilityCheck) -> tuple[str, str]:
    value, limit = (
        UNKNOWN if x is None else percent(x) if check.unit == "%" else number(x) for x in (check.value, check.limit)
    )
    return value, limit


def _outcome_words(check: UsabilityCheck) -> str:
    if check.outcome is CheckOutcome.NOT_POSSIBLE:
        return "not possible" + ("" if check.required else ", not required")
    return plain(check.outcome)


def coefficient_rows(form: ClosedForm) -> list[tuple[str, ...]]:
    """A formula's coefficients: symbol, value, standard deviation."""
    return [(symbol_of(c.name), *value_and_error(c.value, c.std, c.unit)) for c in form.coefficients]


def ladder_rows(ladder: Sequence[Rung | DiagnosisStep]) -> list[tuple[str, ...]]:
    """Ladder steps: the added effect, chi2, rms error fitted and held out, error of the simulated current.

    A step that adds effects without a step of their own, because they are too small to be causes, names them too.
    """
    rows: list[tuple[str, ...]] = []
    before = {rung.added for rung in ladder}
    for k, rung in enumerate(ladder):
        beside = [plain(name) for name in rung.effects if name not in before]
        before.update(rung.effects)
        rows.append(
            (
                rung_name(rung.added, k) + (f" (with {listed(beside)})" if beside else ""),
                number(rung.chi2),
                quantity(rung.rms_v, "V"),
                quantity(rung.heldout_rms_v, "V"),
                quantity(rung.current_rms_a, "A"),
            )
        )
    return rows


def parameter_rows(effect: FoundEffect) -> list[tuple[str, str, str]]:
    """An effect's parameters and the derived values for the drive: name, value, 95 % interval.

    Parameters of its form are counted, not listed. An interval that holds zero is marked.
    """
    sizes = {name: p for name, p in effect.parameters.items() if not p.bends_form}
    rows = []
    for name, p in {**sizes, **effect.derived}.items():
        value, interval = value_and_interval(p.value, p.low, p.high, p.unit)
        holds_zero = p.low is not None and p.high is not None and p.low <= 0.0 <= p.high
        rows.append((parameter_words(name), value, f"{interval}; {_zero(effect, name)}" if holds_zero else interval))
    of_form = len(effect.parameters) - len(sizes)
    return [*rows, ("form", f"{of_form} more in model.json", "")] if of_form else rows


def _zero(effect: FoundEffect, name: str) -> str:
    """That zero fits, and with which other parameter alone where it is the two together that are determined."""
    if name in effect.parameters:
        return companion_words(effect, effect.parameters[name]) or "zero fits too"
    return "likewise" if any(p.determined_with for p in effect.parameters.values()) else "zero fits too"


def companion_words(effect: FoundEffect, parameter: ParameterValue) -> str:
    """What is determined of a parameter that zero fits if another one moves; empty where there is no such one."""
    other = parameter.determined_with
    if other is None:
        return ""
    whose = "" if other.effect == effect.name else f"{plain(other.effect)} "
    name = f"{whose}{parameter_words(other.parameter)}"
    if other.total is None:
        return f"zero fits too if {name} changes with it: only a combination is determined"
    total = measured(other.total, other.total_low, other.total_high, parameter.unit)
    return f"only its sum with {name} is determined: {total}"


def effect_notes(report: DiagnosisReport) -> list[str]:
    """What the effects themselves remark on their sizes."""
    own = tuple(f"{effect.name}." for effect in (*report.effects, *report.minor))
    return [remark.text for remark in report.remarks if remark.code.startswith(own)]


def trace_words(report: DiagnosisReport) -> list[str]:
    """Effects that were detected but are too small to be named, each with the most that it may be."""
    listed_apart = {effect.name for effect in report.minor}
    bounds = {entry.name: joint_bound(entry) for entry in report.joint}
    names = [name for name in report.traces if name not in listed_apart]
    return [plain(name) + (f" ({bounds[name]})" if bounds.get(name) else "") for name in names]


def joint_bound(entry: JointEntry) -> str:
    """How large an effect may be by the joint fit at 95 %: ``at most 1.31 mV``; empty where that is not known."""
    size = entry.size
    if size is None or size.low is None or (size.high is not None and not max(abs(size.low), abs(size.high)) > 0.0):
        return ""
    if size.high is None:
        return f"{parameter_words(entry.parameter)} at least {quantity(size.low, size.unit)}"
    return f"{parameter_words(entry.parameter)} at most {quantity(max(abs(size.low), abs(size.high)), size.unit)}"


def share_rows(effects: Sequence[FoundEffect]) -> list[tuple[str, ...]]:
    """Contributions of effects: name, size and typical size, part of the error, probability, material or not."""
    return [
        (
            plain(effect.name),
            size_in_words(effect),
            part_words(effect),
            probability_words(effect, [other.name for other in effects]),
            {None: UNKNOWN, True: "yes", False: "no"}[effect.material],
        )
        for effect in effects
    ]


def part_words(effect: FoundEffect | EffectBasis) -> str:
    """The error without an effect, and the kind of stage that it is largest in: ``162 % (sweeps)``."""
    text = percent(None if effect.share is None else 100.0 * effect.share)
    return text if effect.share_in is None else f"{text} ({kind_words(effect.share_in)})"


def kind_words(kind: str) -> str:
    """A kind of rows of a recording in words: ``holds``."""
    return _KINDS.get(kind) or plain(kind)


def objection_words(report: EstimationReport, remark: Remark) -> str:
    """A remark on the use of a report's map, without the name of the method, which the map has already."""
    return typographic(remark.text.removeprefix(f"{report.method}: "))


def probability_words(effect: FoundEffect | EffectBasis, named: Iterable[str]) -> str:
    """The probability of an effect; that of the group where others, which are not named, fit as well in its place."""
    text, others = probability(effect.probability), [name for name in effect.twins if name not in named]
    return text if text == UNKNOWN or not others else f"{text} (it or {' or '.join(map(plain, others))})"


def mutual_twins(effects: Sequence[FoundEffect]) -> dict[str, tuple[str, ...]]:
    """What fits as well in each effect's place, by its name; of two effects of the model each is the other's."""
    return {
        one.name: (*one.twins, *(o.name for o in effects if one.name in o.twins and o.name not in one.twins))
        for one in effects
    }


def size_in_words(effect: FoundEffect) -> str:
    """An effect's size and what is typical: ``203 ns (typical: 1.5 µs)``."""
    if effect.relative_size is None:
        return UNKNOWN
    name, typical = sized_parameter(effect), effect.typical
    if name is None or typical is None:
        return f"{percent(100.0 * effect.relative_size)} of the typical size"
    size = {**effect.parameters, **effect.derived}[name]
    return f"{quantity(size.value, size.unit)} (typical: {quantity(typical.value, typical.unit, 2)})"


def sized_parameter(effect: FoundEffect) -> str | None:
    """The parameter or derived quantity that the typical size belongs to; None where no typical size is stated."""
    typical, relative = effect.typical, effect.relative_size
    if typical is None or typical.value is None or relative is None:
        return None
    known = {**effect.parameters, **effect.derived}
    values = {name: abs(p.value) for name, p in known.items() if p.unit == typical.unit and p.value is not None}
    # Of several in this unit, the one of this size; some effects are strong where their only parameter is small.
    size = abs(typical.value * relative)
    return min(values, key=lambda name: abs(values[name] - size), default=None)


def part_notes(effects: Sequence[FoundEffect | EffectBasis]) -> list[str]:
    """What a part of the error is, why one is above 100 %, and what a probability is of."""
    parts = [effect.share for effect in effects if effect.share is not None]
    large = (
        "error without it above 100 %: without this effect the model's error would exceed that of the first model, "
        "whose R_s and map compensated a part of it"
    )
    is_stated = any(effect.probability is not None for effect in effects)
    return [PART_MEANING] * bool(parts) + [large] * any(p >= 1.005 for p in parts) + [PROBABILITY_MEANING] * is_stated


def share_notes(report: DiagnosisReport) -> list[str]:
    """Notes on `share_rows`: parts above 100 %, and causes that are not material."""
    notes = part_notes((*report.effects, *report.minor))
    if report.effects and report.leaves_most:
        notes.append(STAND_IN)
    small = [plain(effect.name) for effect in report.effects if effect.material is False]
    if small and report.materiality is not None:
        flux, volts = percent(report.materiality.flux_percent), percent(report.materiality.voltage_percent)
        notes.append(
            f"{listed(small)}: a cause of the measured error, but not material: it changes the map by less "
            f"than {flux} of the rated flux, and the voltage by less than {volts} of the excitation's"
        )
    return notes


def setting_rows(stage: Mapping[str, object]) -> list[tuple[str, str]]:
    """A proposed stage's settings."""
    return [(plain(name), str(value)) for name, value in stage.items() if value is not None]


def by_import(run: str) -> str:
    """How a stage is measured for a recording that was imported, whose drive is not this bench's."""
    return (
        "log its points with the same drive, import them with the same mapping, and put both together by "
        f"`fluxbench import --merge {run} NEW --out BOTH`"
    )


def benefit_line(remark: Remark, run: str, options: str = "") -> str:
    """A remark of `add` or `remove` on one effect, with the command that undoes the change where that is advised.

    The command gets the same `options`, such as a file of own effects, each with a space before it.
    """
    command = UNDONE_BY[remark.code]
    if command is None:
        return typographic(f"{remark.text}.")
    undoes = {"remove": "removes it again", "add": "puts it back"}[command]
    return typographic(f"{remark.text}; `fluxbench {command} {run} {remark.values['effect']}{options}` {undoes}.")
