"""Bytes of a fuzzer as choices; where they are used up, everything is zero."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


class Choices:
    """Reads from the front; never runs out, and says when it has."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def left(self) -> int:
        """Bytes that have not been used."""
        return max(0, len(self._data) - self._at)

    def some(self, count: int) -> bytes:
        """So many bytes, or the rest."""
        taken = self._data[self._at : self._at + count]
        self._at += count
        return taken

    def whole(self, size: int = 1) -> int:
        """An unsigned number of so many bytes."""
        return int.from_bytes(self.some(size), "little")

    def below(self, limit: int) -> int:
        """A number from 0 to `limit` - 1."""
        return self.whole(1 if limit <= 256 else 2) % limit

    def one_of(self, several: Sequence[T]) -> T:
        """One of them."""
        return several[self.below(len(several))]
