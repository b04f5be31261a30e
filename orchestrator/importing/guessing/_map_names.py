"""Identify the arrays or columns of a flux map's file by name alone."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from orchestrator.importing.guessing._units import name_and_unit

_CURRENT = r"(?:i|is|cur|curr|current|statorcurrent|strom)"
_FLUX = r"(?:psi|psis|flux|fluxlinkage|lambda|lam|lmbd|phi|fl|f|fluss)"
_KIND = r"(?:peak|pk|rms|eff|amp|max)?"
_FORM = (
    r"(?:vec|vector|index|idx|table|tab|tbl|grid|mesh|map|bp|breakpoints?|axis|data|array|list|values?|lut|mat|matrix"
    r"|a|wb|vs)*\d*"
)
_AMPLITUDE = (
    r"(?:is|im|imag|iamp|ipeak|ipk|irms|(?:stator|line|phase)?current)"
    r"(?:magnitude|mag|amplitude|amp|abs|line|stator)?"
)
_CURRENT_ANGLE = r"(?:beta|gamma|(?:current|phase)?(?:angle|advance)|currentphase|(?:current|phase)?advanceangle)"
_ROTOR_ANGLE = (
    r"(?:theta|rotor(?:angle|position|pos)|angle|position|pos|epsilon|(?:electrical|mechanical)angle)"
    r"(?:e|el|elec|m|mech|r)?"
)
_TORQUE = r"(?:torque|te|tem|tel|tau|taum|trq|moment|drehmoment|md|(?:electromagnetic|shaft|airgap)torque)"
_UNIT = re.compile(r"[\s_\[(/]+([mukµμ]?)(wb|vs|n\.?m)[\])]?$", re.IGNORECASE)


@dataclass(frozen=True)
class MapRoles:
    """Column names by role; None where no name fits."""

    i_d: str | None
    i_q: str | None
    amplitude: str | None
    angle: str | None
    psi_d: str | None
    psi_q: str | None
    theta: str | None
    torque: str | None

    @property
    def is_map(self) -> bool:
        """Whether the file has flux linkages and the currents that they depend on."""
        on_axes, polar = None not in (self.i_d, self.i_q), None not in (self.amplitude, self.angle)
        return None not in (self.psi_d, self.psi_q) and (on_axes or polar)


def roles_of_map(names: Sequence[str]) -> MapRoles:
    """The roles of arrays and columns in a flux map's file; peak values take precedence over rms."""
    plain = {name: _plain(name) for name in names}

    def one(pattern: str) -> str | None:
        return _preferred(name for name, text in plain.items() if re.fullmatch(f"{pattern}{_KIND}{_FORM}", text))

    def axis(quantity: str, letter: str) -> str | None:
        return one(rf"(?:{quantity}{_KIND}(?:s|stator)?{letter}|{letter}(?:axis)?{quantity})")

    return MapRoles(
        i_d=axis(_CURRENT, "d"),
        i_q=axis(_CURRENT, "q"),
        amplitude=one(_AMPLITUDE),
        angle=one(_CURRENT_ANGLE),
        psi_d=axis(_FLUX, "d"),
        psi_q=axis(_FLUX, "q"),
        theta=one(_ROTOR_ANGLE),
        torque=one(_TORQUE),
    )


def map_unit(name: str) -> str | None:
    """The unit of flux linkage or torque at the end of a name: ``psi_d [mWb]``, ``Torque(Nm)``, ``psi_q_Vs``."""
    found = _UNIT.search(name)
    if found is None:
        return None
    prefix, unit = found[1].replace("µ", "u").replace("μ", "u"), found[2].lower().replace(".", "")
    return prefix + {"wb": "Wb", "vs": "Vs", "nm": "Nm"}[unit]


def _plain(name: str) -> str:
    """The last part of a name in lower case, without its unit."""
    last = name.rpartition(".")[2] if "/" not in name else name.rpartition("/")[2] or name
    bare = name_and_unit(_UNIT.sub("", last))[0]
    return re.sub(r"[^a-z0-9]", "", bare.lower().replace("λ", "lambda").replace("ψ", "psi"))


def _preferred(names: Iterable[str]) -> str | None:
    return min(names, key=lambda name: ("rms" in name.lower() or "eff" in name.lower(), len(name)), default=None)
