"""Identify columns by name; an ambiguous name identifies none."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from orchestrator.importing._signals import Axis, Frame
from orchestrator.importing.guessing._units import names_and_units, without_channel

_Namings = tuple[tuple[Frame, tuple[dict[Axis, str], ...]], ...]
"""Names of the axes of each frame."""
_AXES: _Namings = (
    ("abc", ({"a": "a", "b": "b", "c": "c"}, {"a": "u", "b": "v", "c": "w"}, {"a": "1", "b": "2", "c": "3"})),
    ("abc", ({"a": "l1", "b": "l2", "c": "l3"}, {"a": "r", "b": "s", "c": "t"}, {"a": "r", "b": "y", "c": "b"})),
    (
        "alpha_beta",
        ({"alpha": "alpha", "beta": "beta"}, {"alpha": "al", "beta": "be"}, {"alpha": "α", "beta": "β"}),
    ),
    ("dq", ({"d": "d", "q": "q"},)),
)
_LINES: _Namings = (("line_to_line", ({"ab": "ab", "bc": "bc", "ca": "ca"}, {"ab": "uv", "bc": "vw", "ca": "wu"})),)
_CURRENT = r"(?:i|cur|curr|current|strom|iphase|phasecurrent|is|im|imot|ichannel)"
_VOLTAGE = r"(?:v|u|volt|voltage|spannung|vs|us|vphase|uphase|phasevoltage|vm|um)"
_DUTY = r"(?:d|duty|dutycycle|pwm|dc)"
_COMMAND = r"(?:ref|cmd|com|set|star|sp|soll|demand|target|command)?"
_ACTUAL = r"(?:meas|act|fb|ist|mess|measured|actual)?"
_ONE: Mapping[str, str] = {
    "time": r"(?:t|time|zeit|timestamp|timestamps|timesec|seconds|xaxis|datetime|date|clock|epoch|tick|ticks)\d*",
    "bus": r"(?:v|u|volt)?(?:dc|bus|dclink|dcbus|zk)(?:v|u|voltage|link|bus|volt|meas|filt)?|(?:v|u)zk",
    "angle": r"(?:theta|angle|rotorangle|epsilon|phi|pos|position|rho|winkel)(?:e|el|elec|electrical|r)?",
    "pwm_frequency": r"(?:f(?:req|requency)?(?:pwm|sw|switching)|(?:pwm|sw|switching)f(?:req|requency)?)(?:k?hz)?",
    "temperature": r"(?:temp|temperature|tempwinding|tmotor|tmot|windingtemp)(?:c|degc)?",
    "label": r"(?:point|segment|label|what|stage|step|teststep|operatingpoint|test|state|mode|run)(?:id|no|nr)?",
}


@dataclass(frozen=True)
class Signal:
    """Columns that make a vector."""

    frame: Frame
    columns: dict[Axis, str]
    is_duty: bool = False


@dataclass(frozen=True)
class Roles:
    """Roles of the columns that their names identify."""

    current: Signal | None
    voltage: Signal | None
    one: dict[str, str]
    """time, bus, angle, PWM frequency, temperature and label."""


def roles_of(names: Sequence[str], called: Mapping[str, str]) -> Roles:
    """The roles of columns by their names, or by the file's descriptions."""
    texts = {name: called.get(name, name) for name in names}
    without_unit = names_and_units(list(texts.values()))
    plain = {name: _plain(without_unit[text][0]) for name, text in texts.items()}
    one: dict[str, str] = {}
    for role, pattern in _ONE.items():
        found = next((name for name in names if re.fullmatch(pattern, plain[name]) and name not in one.values()), None)
        if found is not None:
            one[role] = found
    rest = {name: text for name, text in plain.items() if name not in one.values()}
    current = _signal(rest, _CURRENT, _ACTUAL)
    voltage = (
        _signal(rest, _VOLTAGE, _COMMAND)
        or _signal(rest, _VOLTAGE, _COMMAND, _LINES)
        or _signal(rest, _VOLTAGE, _ACTUAL)
    )
    if voltage is None:
        duty = _signal(plain, _DUTY, _COMMAND)
        if duty is not None and (duty.frame != "abc" or len(duty.columns) == 3):
            voltage = Signal(duty.frame, duty.columns, is_duty=True)
            one = {role: name for role, name in one.items() if name not in duty.columns.values()}
    return Roles(current, voltage, one)


def _plain(name: str) -> str:
    """The letters and digits of a name without its unit, without path and a scope's channel: ``CH2 Ia`` is ``ia``."""
    return re.sub(r"[^a-z0-9αβ]", "", without_channel(name).rpartition("/")[2].rpartition(".")[2])


def _signal(plain: Mapping[str, str], quantity: str, suffix: str, axes: _Namings = _AXES) -> Signal | None:
    for frame, namings in axes:
        for naming in namings:
            found = {axis: _named(plain, quantity, text, suffix) for axis, text in naming.items()}
            known = {axis: name for axis, name in found.items() if name is not None}
            if len(set(known.values())) >= 2:
                return Signal(frame, known)
    return None


def _named(plain: Mapping[str, str], quantity: str, axis: str, suffix: str) -> str | None:
    """The column of an axis: ``ia``, ``current_phase_a``, ``van``, ``Soll_Ud``; commands before measured values."""
    middle = r"(?:phase|ph|s|l)?"
    in_order = rf"{quantity}{middle}{axis}n?{suffix}|{quantity}{suffix}{axis}|{suffix}{quantity}{middle}{axis}n?"
    for pattern in (in_order, rf"(?:phase|ph)?{axis}{quantity}"):  # vu is v of phase u, beside vv and vw
        found = [name for name, text in plain.items() if re.fullmatch(pattern, text)]
        if found:
            return max(found, key=lambda name: len(plain[name]) * ("ref" in suffix))
    return None
