"""The device's interlock inputs: a file stands where the switches would be."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


class Inputs:
    """Inputs that are open while a file has their names, one a line; closed where there is no file.

    Parameters
    ----------
    names : sequence of str
        In the order of their bits.
    file : Path, optional
    """

    def __init__(self, names: Sequence[str], file: Path | None) -> None:
        self._names, self._file = names, file if names else None

    def read(self) -> int:
        """Bits of those that are open now."""
        if self._file is None:
            return 0
        try:
            lines = set(map(str.strip, self._file.read_text("utf-8", "replace").splitlines()))
        except OSError:
            return 0
        return sum(1 << bit for bit, name in enumerate(self._names) if name in lines)
