"""Names for people: states, sections of a diagnosis, verdicts, ladder steps, parameters, maps."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from orchestrator.formatting.sentences import typographic
from protocols import AxisPercent, DiagnosisWords

PAPER_CROSSINGS = AxisPercent(d_percent=1.3, q_percent=2.9)
"""Largest flux difference where current paths cross, as Combes, Malrait, Martin and Rouchon print it."""
MAP_QUANTITIES = {
    "psi_d": ("ψ_d", "mWb"),
    "psi_q": ("ψ_q", "mWb"),
    "l_dd": ("L_dd", "mH"),
    "l_dq": ("L_dq", "mH"),
    "l_qq": ("L_qq", "mH"),
}
"""A flux map's variables: symbol, and the unit in which they are shown."""
_PARAMETER_UNITS = (
    "_ohm_per_a2",
    "_per_ohm",
    "_a_per_s",
    "_per_s",
    "_a",
    "_v",
    "_s",
    "_hz",
    "_ohm",
    "_rad",
    "_wb",
    "_h",
    "_w",
    "_j",
    "_k",
    "_per_watt",
    "_per_a2",
)

_PARAMETER_MEANINGS = {
    "threshold_a": "current below which it fades",
    "rad_per_nm": "twist by torque",
    "square_per_a": "square term",
    "cubic_per_a2": "cubic term",
    "per_watt": "change by power",
    "per_k": "change by temperature",
}
"""Parameters whose names alone do not say what they are of."""


@dataclass(frozen=True)
class Verdict:
    """A verdict's name and meaning."""

    name: str
    meaning: str
    mood: str
    """"good", "warning" or "bad"."""


VERDICTS = {
    "clean": Verdict("Clean", "the model fits within the noise", "good"),
    "explained": Verdict("Explained", "with the effects below, the model fits", "good"),
    "explained_in_another_form": Verdict(
        "Explained, in another form", "the effects below explain the error, in another form than the library's", "good"
    ),
    "mostly_explained": Verdict("Mostly explained", "the effects below account for most of the error", "warning"),
    "unknown_remains": Verdict("Unknown remains", "no effect of the library explains the residual", "bad"),
    "convention": Verdict("Convention", "manifest or logging contradict the readings: see below", "bad"),
    "cannot_tell": Verdict("Cannot tell", "too few or too noisy measurements", "bad"),
}
OUTCOME_MOODS = {"finished": "good", "aborted": "warning", "faulted": "bad"}


def plain(name: str) -> str:
    """A name of the code (a state, an effect, a section) as words."""
    return name.replace("_", " ")


def slots(words: DiagnosisWords) -> Iterator[tuple[str, str]]:
    """The non-empty sections of a diagnosis, title and text, in reading order."""
    for slot in DiagnosisWords.model_fields:
        text = getattr(words, slot)
        if text:
            yield plain(slot), typographic(text)


def rung_name(added: str | None, index: int) -> str:
    """A ladder step's name by the effect that it adds."""
    if added is None:
        return "the model alone" if index == 0 else "refitted"
    return f"+ {plain(added)}"


def map_source(method: str) -> str:
    """Where a flux map comes from: the fitted model, or an estimator by name."""
    return "of the fitted model" if method == "model" else f"by {method}"


def code_identifier(name: str) -> str:
    """A motor's name as a valid C and Modelica name: lower-case letters, digits, underscores."""
    identifier = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")[:32].strip("_")
    return identifier if identifier[:1].isalpha() else f"motor_{identifier}".rstrip("_")


def symbol_of(name: str) -> str:
    """A coefficient's symbol: alpha12 is α12."""
    return name.replace("alpha", "α")


def parameter_words(name: str) -> str:
    """A parameter's name without its unit: bias_a_v is bias a, rise_per_watt is rise."""
    if name in _PARAMETER_MEANINGS:
        return _PARAMETER_MEANINGS[name]
    suffix = next((s for s in _PARAMETER_UNITS if name.endswith(s) and len(name) > len(s)), "")
    return plain(name.removesuffix(suffix))
