"""A law as the text of an effect plugin: one class, in a file that needs numpy and this project alone."""

from __future__ import annotations

import inspect
import keyword
import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.discovery.bases import CurveBasis
from orchestrator.discovery.forms import FormFit
from orchestrator.discovery.hypotheses import ALL, PHASE_NAMES, Hypothesis
from orchestrator.discovery.law import Law, Line, Table
from orchestrator.discovery.places import READING, READING_BY_TIME
from orchestrator.discovery.quantities import CURRENT, NEXT_CURRENT, PHASE_CURRENT, PREVIOUS_CURRENT
from orchestrator.formatting.sentences import visible

OF_READINGS = (PHASE_CURRENT, NEXT_CURRENT, PREVIOUS_CURRENT, CURRENT)
"""Quantities that a sensor's error changes."""
INVERSION_ERROR: float = 5e-4
"""Part of a sensor's error to which the rounds that find the true current know it."""
INVERSION_ROUNDS: tuple[int, int] = (4, 12)
"""Fewest and most of these rounds: each leaves as much of the error as its slope in A/A."""

LONG_LAG_S: float = 0.02
"""Time constant of a lag that the time between two segments may not have ended [s]."""


@dataclass(frozen=True)
class NamedLaw:
    """A law as it is written.

    Attributes
    ----------
    law : Law
    name : str
        Of the effect.
    story : sequence of str
        What was found on which recording, a paragraph each.
    """

    law: Law
    name: str
    story: Sequence[str] = ()


def source_of(laws: Sequence[NamedLaw], factors: Mapping[str, float], three_sensors: bool) -> str:
    """The text of a file with these laws, a class each.

    Parameters
    ----------
    factors : mapping of str to float
        Ratio of this machine to the reference machine, by unit.
    three_sensors : bool
        Whether the current's vector was made of three readings.
    """
    docstring, tables, classes, helpers = list[str](), list[str](), list[str](), list[str]()
    for k, one in enumerate(laws):
        summary, suffix = sentence_of(one.law.hypothesis), str(k + 1) if k else ""
        body = _body(one.law, three_sensors, suffix)
        first = f"y = {one.law.formula}: {summary[0].lower()}{summary[1:]}"
        docstring += map(_wrapped, (first, *one.story))
        classes.append(_class(one.law, one.name, summary, body, factors, three_sensors))
        helpers += [text for text in (_OVER_INTERVAL, _PULSE_RATE) if _name_of(text) in body]
        of = one.law.hypothesis
        for quantity in (of.quantity, of.place.factor):
            if quantity is not None:
                source = inspect.getsource(quantity.of)
                helpers.append(source.replace("Signals | SignalBatch", "Signals").rstrip())
        if isinstance(one.law.form, Table):
            tables.append(_table_lines(one.law.form, suffix))
    code = "\n\n\n".join([*classes, *dict.fromkeys(helpers)]) + "\n"
    constants = "\n" + "\n".join(tables) if tables else ""
    paragraphs = "\n\n".join(docstring)
    return f'"""{paragraphs}\n"""\n\n{_imports(code + constants)}\n{constants}\n\n{code}'


def _name_of(helper: str) -> str:
    """``_name(`` of a helper's text."""
    return helper.split("(")[0].removeprefix("def ") + "("


def sentence_of(hypothesis: Hypothesis) -> str:
    """What the law says, in one sentence."""
    phase = PHASE_NAMES[hypothesis.phases]
    of_phase = f", in phase {phase} alone" if phase else ""
    return f"{_capital(hypothesis.place.text)}, as a function of {hypothesis.quantity.text}{of_phase}."


def gauge_of(hypothesis: Hypothesis) -> str:
    """What no measurement of this kind can tell of such a law; empty where there is nothing."""
    name, everywhere = hypothesis.place.name, hypothesis.phases == ALL
    if name in ("voltage_gain", "reading_gain") and everywhere:
        return "Only the ratio of the voltage's gain to the current's shows: either may be the cause."
    if name in ("leg_voltage", "pulse_voltage") and everywhere and hypothesis.quantity.name == "phase_currents":
        return "A part in proportion to the current counts as R_s."
    if name == "reading" and everywhere and hypothesis.quantity.name == "phase_currents":
        return "A part in proportion to the current counts as R_s and map."
    if name == "resistance":
        return "A constant part counts as R_s."
    return ""


def _class(law: Law, name: str, summary: str, body: str, factors: Mapping[str, float], three_sensors: bool) -> str:
    parameters = "\n".join(_fold(p.declared(factors.get(p.unit, 1.0))) for p in law.parameters)
    hypothesis = law.hypothesis
    return f'''class {_camel(name)}:
    """y = {law.formula}."""

    name = "{name}"
    summary = "{summary}"
    signature = "A residual of the form y = {law.formula}."
    layer = EffectLayer.{hypothesis.place.layer.name}
    needs = ()
    gauge = "{gauge_of(hypothesis)}"

    class Parameters(EffectParameters):
{parameters}

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """The signals without it."""
{textwrap.indent(body, "        ")}{_random_directions(law, three_sensors)}'''


def _random_directions(law: Law, three_sensors: bool) -> str:
    """The method of the unknown beginning of a play or of a long lag; empty of any other law."""
    hypothesis, place = law.hypothesis, law.hypothesis.place
    if not isinstance(law.form, FormFit) or law.form.form is not None:
        return ""
    size, scale = (f"p.{parameter.name}" for parameter in law.parameters)
    correction = place.code.format(sensors=_sensors(three_sensors))
    x = f"{hypothesis.quantity.name}(signals)"
    if hypothesis.basis.kind == "lag" and law.form.scale > LONG_LAG_S:
        phases = "" if hypothesis.phases == ALL else f" * {list(hypothesis.phases)}"
        return f'''

    def random_directions(self, signals: Signals, p: Parameters) -> list[Correction]:
        """What the lags remember when a segment begins, by one standard deviation."""
        y = {size} * fading_memory({x}, {scale}, signals){phases}
        return [{correction}]'''
    if hypothesis.basis.kind != "play":
        return ""
    two = place.name == "reading" and not three_sensors
    each = [phase for phase in _phases_of(hypothesis) if not (two and phase[2])]
    return f'''

    def random_directions(self, signals: Signals, p: Parameters) -> list[Correction]:
        """What each phase's play remembers when a segment begins, by one standard deviation."""
        far = {size} * unknown_memory({x}, {scale}, signals)
        each = [far * phase for phase in {each}]
        return [{correction} for y in each]'''


def _phases_of(hypothesis: Hypothesis) -> list[list[float]]:
    return [[float(k == j) for j in range(3)] for k in range(3) if hypothesis.phases[k]]


def _sensors(three_sensors: bool) -> str:
    return "from_phases(y)" if three_sensors else "from_two_phases(y[:, 0], y[:, 1])"


def _body(law: Law, three_sensors: bool, suffix: str) -> str:
    hypothesis, place, quantity = law.hypothesis, law.hypothesis.place, law.hypothesis.quantity
    size, *shapes = [f"p.{p.name}" for p in law.parameters]
    lines = [f"x = {quantity.name}(signals)"]
    form = law.form
    if isinstance(form, Line):
        lines = [f"turns = 2.0 * np.pi * {shapes[-1]} * {quantity.name}(signals)"]
        pairs = zip([size, *shapes[1:-1:2]], shapes[:-1:2], strict=True)
        waves = [f"{sine} * np.sin(turns) + {cosine} * np.cos(turns)" for sine, cosine in pairs]
        lines += ["y = np.zeros((len(turns), 3))"] if len(waves) > 1 else [f"y = {waves[0]}"]
        lines += [f"y[:, {phase}] = {wave}" for phase, wave in enumerate(waves) if len(waves) > 1]
        return "\n".join([*lines, f"return {place.code.format(sensors=_sensors(three_sensors))}"])
    if isinstance(form, Table):
        u = f"np.interp({{x}} / {shapes[0]}, X{suffix}, Y{suffix})"
        if form.parity != "none":
            u = u.format(x="np.abs({x})") if form.parity == "even" else "np.sign({x}) * " + u.format(x="np.abs({x})")
        expression = f"{size} * {u.format(x='x')}"
    elif form.form is None:
        memory = {"lag": "x - lagged", "play": "x - play", "cooling": "cooled", "late": "lagged"}[hypothesis.basis.kind]
        single = "[:, 0]" if hypothesis.basis.kind == "late" and not quantity.of_phases else ""
        expression = f"{size} * {_bracketed(f'{memory}(x, {shapes[0]}, signals){single}')}"
    else:
        code = re.sub(r"\bb\b", shapes[0], form.form.code) if form.form.has_scale else form.form.code
        code = re.sub(r"\bp\b(?!\.)", shapes[1], code) if form.form.has_power else code
        expression = f"{size} * {_bracketed(code)}"
    is_memory = isinstance(form, FormFit) and form.form is None
    if place.over_interval and not is_memory:
        lines += [f"y = _over_interval(lambda x: {expression}, x)"]
    else:
        lines += [f"y = {expression}"]
    if place.of_phases:
        if quantity.of_phases:
            lines += [f"y = y * {list(hypothesis.phases)}"] if hypothesis.phases != ALL else []
        else:
            lines += [f"y = y[:, None] * {list(hypothesis.phases)}"]
        if place.name == "reading_gain":
            lines += ["y = y / (1.0 + y) * to_phases(signals.i_ab)"]
    if place.factor is not None:
        lines += [f"y = y * {place.factor.name}(signals)[:, None]"]
    correction = place.code.format(sensors=_sensors(three_sensors))
    if not is_memory and place in (READING, READING_BY_TIME) and quantity in OF_READINGS:
        return _of_true_current(lines, correction, _rounds(law))
    return "\n".join([*lines, f"return {correction}"])


def _rounds(law: Law) -> int:
    """Rounds that find the true current, by the steepest slope of a law over its range."""
    basis = law.hypothesis.basis
    assert isinstance(basis, CurveBasis)
    x = basis.grid(12 * basis.cells)
    x = x[x > 0.0]
    slope = float(np.abs(np.gradient(law.values(x), x)).max())
    needed = math.log(INVERSION_ERROR) / math.log(min(max(slope, 1e-6), 0.9))
    return int(np.clip(math.ceil(needed), *INVERSION_ROUNDS))


def _of_true_current(lines: Sequence[str], correction: str, rounds: int) -> str:
    """A body whose law depends on the current before the sensors' error, found by fixed-point iteration."""
    first = lines[0].replace("(signals)", "(true)")
    bounded = "y = np.clip(y, -largest, largest)"
    body = textwrap.indent("\n".join([first, *lines[1:], bounded, f"true = signals.corrected({correction})"]), "    ")
    head = [
        "# The law is one of the true current, which these rounds find where the error is less than the current.",
        "true, largest = signals, np.abs(signals.i_ab).max()",
    ]
    return "\n".join([*head, f"for _ in range({rounds}):", body, "return Correction(i_ab=true.i_ab)"])


def _bracketed(code: str) -> str:
    return code if re.fullmatch(r"[\w.]+(\([^()]*\))?", code) else f"({code})"


_OVER_INTERVAL = '''def _over_interval(law, x):
    """Mean of a law over the interval after each sample, by Simpson's rule."""
    after = np.concatenate([x[1:], x[-1:]])
    return (law(x) + 4.0 * law(0.5 * (x + after)) + law(after)) / 6.0'''


_PULSE_RATE = '''def _pulse_rate(signals):
    """PWM frequency over the drive's usual one."""
    usual = signals.drive.pwm_frequency_hz if signals.drive is not None else None
    return signals.pwm_frequency_hz / (usual or signals.pwm_frequency_hz)'''


def _table_lines(table: Table, suffix: str) -> str:
    rows = [
        f"{name}{suffix} = np.array({[round(float(v), 4) for v in values]})"
        for name, values in (("X", table.x), ("Y", table.y))
    ]
    return "\n".join("\n".join(textwrap.wrap(row, 118, subsequent_indent="    ")) for row in rows)


def _imports(code: str) -> str:
    frames = [n for n in ("from_phases", "from_two_phases", "to_dq", "to_phases") if re.search(rf"\b{n}\(", code)]
    kept = ("cooled", "earlier", "fading_memory", "lagged", "play", "slopes", "unknown_memory")
    memory = [n for n in kept if re.search(rf"\b{n}\(", code)]
    shapes = ", ".join(["amplitude", *(["shape"] if " shape(" in code else [])])
    return "\n".join(
        [
            "from __future__ import annotations\n",
            "import numpy as np\n",
            *([f"from orchestrator.discovery import {', '.join(memory)}"] if memory else []),
            *([f"from orchestrator.numerics.frames import {', '.join(frames)}"] if frames else []),
            "from orchestrator.numerics.types import Array",
            f"from protocols import Correction, EffectLayer, EffectParameters, Signals, {shapes}",
        ]
    )


def _fold(line: str) -> str:
    """A declaration on several lines where it is too long for one."""
    if len(line) <= 118:
        return line
    head, arguments = line.split("(", 1)
    return f"{head}(\n            {arguments[:-1]}\n        )"


def _wrapped(text: str) -> str:
    """A paragraph of a docstring; a recording's name may hold anything, and must neither end nor escape it."""
    return textwrap.fill(visible(text).replace("\\", "/").replace('"', "'"), 118)


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


_OWN_NAMES = re.compile(r"Array|Correction|EffectLayer|EffectParameters|Signals|[XY]\d*")
"""What a written file calls by these names itself."""


def _camel(name: str) -> str:
    """The class of an effect; another word where Python or the file has that one."""
    camel = "".join(word.capitalize() for word in name.split("_"))
    return f"{camel}Law" if keyword.iskeyword(camel) or _OWN_NAMES.fullmatch(camel) else camel
