"""A law as the text of an effect plugin: one class in one file, which needs numpy and this project alone."""

from __future__ import annotations

import inspect
import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from orchestrator.discovery.forms import FormFit
from orchestrator.discovery.hypotheses import ALL, PHASE_NAMES, Hypothesis
from orchestrator.numerics.types import Array
from protocols import unit_powers

NAME_OF_SIZE = "size"
WIDTH_OF_SIZE: float = 1.0
"""Prior width of a size, relative to its typical value."""
WIDTH_OF_SHAPE: float = 0.7
"""Prior width of a shape, in its logarithm."""
WIDTH_OF_UNIT: float = 1e-3
"""Prior width of a shape that only states at which value of the quantity the size is meant."""
POWER_BOUNDS: Mapping[str, tuple[float, float, float]] = {
    "exponent": (0.5, 0.05, 12.0),
    "sharpness": (2.0, 1.0, 1e4),
}
"""Prior width of a power's logit, and its bounds."""
REACH: float = 100.0
"""Bounds of a size, relative to its typical value, and of a shape."""


@dataclass(frozen=True)
class Table:
    """A curve between points.

    Attributes
    ----------
    x, y : array, shape (m,)
        In units of the largest; odd and even curves for x >= 0 alone.
    top : float
        Largest value of the quantity.
    size : float
        Largest value of the law.
    parity : str
    """

    x: Array
    y: Array
    top: float
    size: float
    parity: str


@dataclass(frozen=True)
class Law:
    """A law with its constants.

    Attributes
    ----------
    hypothesis : Hypothesis
        Place, quantity and phases.
    form : FormFit or Table
    """

    hypothesis: Hypothesis
    form: FormFit | Table

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its constants, the size first."""
        y, x, form = self.hypothesis.place.unit, self.hypothesis.quantity.unit, self.form
        if isinstance(form, Table):
            return (_size(y, form.size), _shape("range", x, form.top, WIDTH_OF_UNIT))
        if form.form is None:
            kind = self.hypothesis.basis.kind
            shape = _shape("lag", "s", form.scale) if kind == "lag" else _shape("radius", x, form.scale)
            return (_size(_quotient(y, x, 1), form.size), shape)
        found = [_size(_quotient(y, x, form.form.power_of_x), form.size)]
        if form.form.has_scale:
            # A power's scale and size are one number: the scale only says where the size is meant.
            is_unit = form.form.has_power and form.form.power_name == "exponent"
            found.append(_shape("scale", x, form.scale, WIDTH_OF_UNIT if is_unit else WIDTH_OF_SHAPE))
        if form.form.has_power:
            found.append(
                Parameter(form.form.power_name, "1", form.power, *POWER_BOUNDS[form.form.power_name], is_size=False)
            )
        return tuple(found)

    @property
    def formula(self) -> str:
        """As a person reads it."""
        hypothesis, form = self.hypothesis, self.form
        x = hypothesis.quantity.symbol
        if isinstance(form, Table):
            return f"a table over {x}"
        if form.form is None:
            return f"a ({x} - {x} {'lagging by' if hypothesis.basis.kind == 'lag' else 'with a play of'} b)"
        return (
            re.sub(r"\bx\b", x.replace("|", ""), form.form.formula)
            if "|" in x
            else re.sub(r"\bx\b", x, form.form.formula)
        )

    @property
    def label(self) -> str:
        """Short name of its form."""
        if isinstance(self.form, Table):
            return "table"
        return self.form.form.name if self.form.form is not None else self.hypothesis.basis.kind


@dataclass(frozen=True)
class Parameter:
    """A constant of a written law."""

    name: str
    unit: str
    value: float
    width: float
    low: float
    high: float
    is_size: bool

    def declared(self, factor: float) -> str:
        """Its line in the class, with values of the reference machine; `factor` is this machine's over that one's."""
        role = "amplitude" if self.is_size else "shape"
        value, low, high = (_rounded(v / factor) for v in (self.value, self.low, self.high))
        width = _rounded(self.width / factor) if self.is_size else _rounded(self.width)
        return (
            f"        {self.name}: float = {role}("
            f'"{self.unit}", typical={value!r}, prior_width={width!r}, low={low!r}, high={high!r})'
        )


def _size(unit: str, value: float) -> Parameter:
    name = "_".join([NAME_OF_SIZE, *([_suffix(unit)] if unit != "1" else [])])
    far = REACH * abs(value)
    return Parameter(name, unit, value, WIDTH_OF_SIZE * abs(value), -far, far, is_size=True)


def _shape(name: str, unit: str, value: float, width: float = WIDTH_OF_SHAPE) -> Parameter:
    return Parameter(f"{name}_{_suffix(unit)}", unit, value, width, value / REACH, value * REACH, is_size=False)


def _suffix(unit: str) -> str:
    return unit.lower().replace("1/", "per_").replace("/", "_per_").replace(" ", "_").replace("^", "")


def _quotient(unit: str, by: str, power: int) -> str:
    """The unit of one unit over a power of another."""
    powers = dict(unit_powers(unit)) if unit != "1" else {}
    for symbol, exponent in unit_powers(by).items():
        powers[symbol] = powers.get(symbol, 0) - power * exponent
    above, below = (
        " ".join(f"{s}^{sign * k}" if sign * k > 1 else s for s, k in powers.items() if sign * k > 0 and s != "1")
        for sign in (1, -1)
    )
    return f"{above or '1'}/{below}" if below else above or "1"


def source_of(law: Law, name: str, story: Sequence[str], factors: dict[str, float], three_sensors: bool) -> str:
    """The text of the file.

    Parameters
    ----------
    name : str
        Of the effect.
    story : sequence of str
        What was found on which recording, a paragraph each.
    factors : dict
        Ratio of this machine to the reference machine, by unit.
    three_sensors : bool
        Whether the current's vector was made of three readings.
    """
    hypothesis = law.hypothesis
    summary = sentence_of(hypothesis)
    body = _body(law, three_sensors)
    helper = inspect.getsource(hypothesis.quantity.of).replace("Signals | SignalBatch", "Signals").rstrip()
    after = [text for text in (_OVER_INTERVAL, _PULSE_RATE) if text.split("(")[0].removeprefix("def ") + "(" in body]
    code = "\n\n\n".join([_class(law, name, summary, body, factors), *after, helper]) + "\n"
    docstring = "\n\n".join([_wrapped(f"y = {law.formula}: {summary[0].lower()}{summary[1:]}"), *map(_wrapped, story)])
    tables = _table_lines(law.form) if isinstance(law.form, Table) else ""
    return f'"""{docstring}\n"""\n\n{_imports(code + tables)}\n{tables}\n\n{code}'


def sentence_of(hypothesis: Hypothesis) -> str:
    """What the law says, in one sentence."""
    phase = PHASE_NAMES[hypothesis.phases]
    of_phase = f", in phase {phase} alone" if phase else ""
    return f"{_capital(hypothesis.place.text)}, as a function of {hypothesis.quantity.text}{of_phase}."


def _class(law: Law, name: str, summary: str, body: str, factors: dict[str, float]) -> str:
    parameters = "\n".join(_fold(p.declared(factors.get(p.unit, 1.0))) for p in law.parameters)
    hypothesis = law.hypothesis
    return f'''class {_camel(name)}:
    """y = {law.formula}."""

    name = "{name}"
    summary = {summary!r}
    signature = "A residual of the form y = {law.formula}."
    layer = EffectLayer.{hypothesis.place.layer.name}
    needs = ()
    gauge = ""

    class Parameters(EffectParameters):
{parameters}

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """The signals without it."""
{textwrap.indent(body, "        ")}'''


def _body(law: Law, three_sensors: bool) -> str:
    hypothesis, place, quantity = law.hypothesis, law.hypothesis.place, law.hypothesis.quantity
    size, *shapes = [f"p.{p.name}" for p in law.parameters]
    lines = [f"x = {quantity.name}(signals)"]
    form = law.form
    if isinstance(form, Table):
        u = f"np.interp({{x}} / {shapes[0]}, X, Y)"
        if form.parity != "none":
            u = u.format(x="np.abs({x})") if form.parity == "even" else "np.sign({x}) * " + u.format(x="np.abs({x})")
        expression = f"{size} * {u.format(x='x')}"
    elif form.form is None:
        expression = f"{size} * (x - {'lagged' if hypothesis.basis.kind == 'lag' else 'play'}(x, {shapes[0]}, signals))"
    else:
        code = re.sub(r"\bb\b", shapes[0], form.form.code) if form.form.has_scale else form.form.code
        code = re.sub(r"\bp\b(?!\.)", shapes[1], code) if form.form.has_power else code
        expression = f"{size} * {_bracketed(code)}"
    is_memory = not isinstance(form, Table) and form.form is None
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
    sensors = "from_phases(y)" if three_sensors else "from_two_phases(y[:, 0], y[:, 1])"
    lines += [f"return {place.code.format(sensors=sensors)}"]
    return "\n".join(lines)


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


def _table_lines(table: Table) -> str:
    rows = [
        f"{name} = np.array({[round(float(v), 4) for v in values]})"
        for name, values in (("X", table.x), ("Y", table.y))
    ]
    return "\n" + "\n".join("\n".join(textwrap.wrap(row, 118, subsequent_indent="    ")) for row in rows)


def _imports(code: str) -> str:
    frames = [n for n in ("from_phases", "from_two_phases", "to_dq", "to_phases") if re.search(rf"\b{n}\(", code)]
    memory = [n for n in ("lagged", "play") if re.search(rf"\b{n}\(", code)]
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
    return textwrap.fill(text, 118)


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _camel(name: str) -> str:
    return "".join(word.capitalize() for word in name.split("_"))


def _rounded(value: float) -> float:
    return 0.0 if value == 0.0 or not math.isfinite(value) else float(f"{value:.4g}")
