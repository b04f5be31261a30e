"""The second examiner's table as a page: figures with their intervals, by machine, plan and effect, and every miss."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from tests.blind.foreign.cases import KINDS, NO_CATALOGUE, SINCE_IN_CATALOGUE
from tests.blind.foreign.examine import Answer
from tests.blind.foreign.judge import MAP_PERCENT, MATERIAL_FLUX_PERCENT, MATERIAL_VOLTAGE_PERCENT, Judgement
from tests.blind.foreign.plans import PLANS
from tests.blind.score import wilson

INTRODUCTION = """\
# The blind suite with other forms and other plans

This page tells you how `fluxbench diagnose` does on recordings of a second plant, whose machines, effects and
plans have other forms than those of [the blind suite](blind-suite.md). To examine it anew (some hours):

    python -m tests.blind.foreign --seed {seed} --write docs/blind-suite-foreign.md

| | what there is |
| --- | --- |
| machines, sharp | reluctance networks whose bridges saturate within 5 to 8 % of the current range, a SynRM |
| machines, soft | a cross-saturated arctangent, a measured map, one by finite elements |
| iron | eddy currents of half order (six branches), vector Preisach hysteresis |
| inverter | dead time by the charge of output capacitances, a knee by the inverse hyperbolic sine, short pulses |
| bus, winding, brake | two resistors with two capacitors, a thermal ladder, a spring with LuGre friction |
| sensors | Hall sensors of second order, offsets, unequal gains, reconstructed shunts, a wrong angle, a late voltage |
| in no catalogue | {foreign} |
| plans | {plans} |

The plan `drawn` has parts and options at random. All classes but the last use the standard plan, one angle, or slow
ramps.

The plant itself works out what the hidden effects do to whoever knows the true map and R_s. They are material where
they move the flux by more than {flux:g} % of the rated flux. So are they where they move the voltage by more than
{voltage:g} % of the excitation.

Date {date}, seed {seed}, {count} recordings of the {usual} that it makes: {counts}.
"""
SIZES = """\
## Sizes

The table compares what an answer states of an effect with what the plant does, in the same physical terms. Only
recordings whose effect is named are compared. Hysteresis and the brake have a range where their form has no single
value. Eddy currents are compared by their conductance in phase at the injection's frequency, heating by the rise
of R_s in the end. Time constants and the shapes of knees are not compared.
"""


def page(judgements: Sequence[Judgement], seed: int, date: str, usual: int) -> str:
    """The whole page, as Markdown."""
    ordered = sorted(judgements, key=lambda j: (KINDS.index(j.answer.case.kind), j.answer.case.index))
    kinds = [j.answer.case.kind for j in ordered]
    foreign = (name for name in NO_CATALOGUE if name not in SINCE_IN_CATALOGUE)
    introduction = INTRODUCTION.format(
        seed=seed, date=date, count=len(ordered), usual=usual, flux=MATERIAL_FLUX_PERCENT,
        voltage=MATERIAL_VOLTAGE_PERCENT, foreign=", ".join(foreign), plans=", ".join(PLANS),
        counts=", ".join(f"{kinds.count(kind)} {kind.replace('_', ' ')}" for kind in dict.fromkeys(kinds)),
    )  # fmt: skip
    machine = _groups(ordered, lambda a: f"{a.case.family} ({'sharp' if a.case.rig.motor.sharp else 'soft'})")
    plan = _groups(ordered, lambda a: a.case.rig.plan)
    parts = [
        introduction,
        *_table(("figure", "right", "of", "%", "95 % interval"), _figures(ordered)),
        _effort(ordered) + "\n",
        "## By machine and by plan\n",
        *_table(("machine", "right in everything", "of"), machine),
        *_table(("plan", "right in everything", "of"), plan),
        "## Maps\n",
        f"The delivered maps against the plant's own. Off: more than {MAP_PERCENT:g} % of the rated flux.\n",
        *_table(
            ("class", "maps", "usable", "usable though off", "rms error, %: median", "at most", "in their 95 %, %",
             "R_s error, %"), _maps(ordered),
        ),
        SIZES,
        *_table(("effect", "amount", "inside", "of", "relative error: median", "at most"), _sizes(ordered)),
        "## Wrong answers\n",
        f"`python -m tests.blind.foreign --make CASE --seed {seed} --out DIR` makes a recording again.\n",
        *_table(
            ("case", "machine, plan", "hidden", "does to flux, voltage", "stated", "missed"), _misses(ordered)
        ),
    ]  # fmt: skip
    return "\n".join(parts).rstrip("\n") + "\n"


def _table(head: Sequence[str], rows: Iterable[str]) -> list[str]:
    return [f"| {' | '.join(head)} |", f"| {' | '.join('---' for _ in head)} |", *rows, ""]


def stated(answer: Answer) -> str:
    """An answer in a line."""
    report = answer.report
    if report is None:
        return f"refused: {answer.error}"
    names = [e["name"] + (f" (or {', '.join(e['twins'])})" if e["twins"] else "") for e in report["effects"]]
    smaller = [e["name"] for e in report["minor"]]
    chi2 = [step["chi2"] for step in (report["ladder"][0], report["ladder"][-1])] if report["ladder"] else []
    words = f"{report['verdict'].replace('_', ' ')}: {', '.join(names) or 'no name'}"
    words += f"; smaller {', '.join(smaller)}" if smaller else ""
    words += f"; chi2 {' to '.join(f'{x:.3g}' for x in chi2 if x is not None)}" if chi2 else ""
    if answer.delivered is not None:
        words += f"; map {answer.delivered['map_percent']:.2g} % off"
        words += ", usable" if answer.delivered["usable"] else ", not usable"
    return words


def _figures(judgements: Sequence[Judgement]) -> Iterable[str]:
    for figure in dict.fromkeys(name for j in judgements for name in j.right):
        outcomes = [j.right[figure] for j in judgements if figure in j.right]
        yield _row(figure, sum(outcomes), len(outcomes))
    inside = [size.inside for j in judgements for size in j.sizes]
    if inside:
        yield _row("95 % intervals that hold the truth", sum(inside), len(inside))


def _row(figure: str, hits: int, count: int) -> str:
    low, high = wilson(hits, count)
    return f"| {figure} | {hits} | {count} | {100 * hits / count:.0f} | {100 * low:.0f}..{100 * high:.0f} |"


def _effort(judgements: Sequence[Judgement]) -> str:
    if not judgements:
        return "Nothing was examined."
    cpu, samples = (np.array([getattr(j.answer, name) for j in judgements]) for name in ("cpu_s", "samples"))
    return (
        f"A diagnosis of {np.median(samples) / 1e6:.2f} M samples takes {np.median(cpu):.1f} s of one core at the "
        f"median, {cpu.max():.1f} s at most, and {max(j.answer.peak_mb for j in judgements):.0f} MB at most."
    )


def _groups(judgements: Sequence[Judgement], group: Callable[[Answer], str]) -> Iterable[str]:
    for name in sorted({group(j.answer) for j in judgements}):
        own = [j for j in judgements if group(j.answer) == name]
        yield f"| {name} | {sum(not j.wrong for j in own)} | {len(own)} |"


def _maps(judgements: Sequence[Judgement]) -> Iterable[str]:
    for kind in KINDS:
        known = [j.answer.delivered for j in judgements if j.answer.case.kind == kind and j.answer.delivered]
        if known:
            off, inside, ohm = (
                np.array([d[n] for d in known]) for n in ("map_percent", "inside", "resistance_percent")
            )
            usable = np.array([d["usable"] for d in known])
            yield (
                f"| {kind.replace('_', ' ')} | {len(known)} | {usable.sum()} | {(usable & (off > MAP_PERCENT)).sum()} "
                f"| {np.median(off):.3f} | {off.max():.3f} | {100 * np.median(inside):.0f} | {np.median(ohm):.3f} |"
            )


def _sizes(judgements: Sequence[Judgement]) -> Iterable[str]:
    every = [size for j in judgements for size in j.sizes]
    for effect, amount in sorted({(size.effect, size.amount) for size in every}):
        own = [size for size in every if (size.effect, size.amount) == (effect, amount)]
        off = np.array([size.off for size in own])
        yield (
            f"| {effect} | {amount} | {sum(size.inside for size in own)} | {len(own)} "
            f"| {np.median(off):.2g} | {off.max():.2g} |"
        )


def _misses(judgements: Sequence[Judgement]) -> Iterable[str]:
    for j in judgements:
        wrong = [*j.wrong, *(f"{s.amount}: {s.stated[1]:.3g} ({s.stated[0]:.3g} to {s.stated[2]:.3g}) instead of "
                             f"{s.true[0]:.3g}" for s in j.sizes if not s.inside)]  # fmt: skip
        if wrong:
            case, does = j.answer.case, j.answer.does
            yield (
                f"| {case.label} | {case.family}, {case.rig.plan} | {case.hidden} | {does['flux_percent']:.2g} %, "
                f"{does['voltage_percent']:.2g} % | {stated(j.answer)} | {'; '.join(wrong)} |"
            )
