"""Memory that two processes share, and messages through it: structure as JSON, arrays as they lie in memory.

Numbers arrive as they were sent to the last bit, and arrays in the order of memory that they had: what is computed
from them in another process is what would have been computed in this one.
"""

from __future__ import annotations

import json
import mmap
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Content = Any
"""None, bool, int, float, str, arrays, and lists and dicts by str of these."""

_ARRAY = "@"
_ALIGNED = 64


@dataclass
class SharedRoom:
    """Memory for one message at a time; what a process forked after it was made shares."""

    size: int
    _memory: mmap.mmap = field(init=False)

    def __post_init__(self) -> None:
        # Of what is asked for only what is used is ever there.
        self._memory = mmap.mmap(-1, self.size)

    def packed(self, content: Content) -> bytes:
        """A message; its arrays are left in the room.

        Raises
        ------
        MemoryError
            Where they do not fit in.
        """
        end = 0

        def placed(array: object) -> dict[str, object]:
            nonlocal end
            if not isinstance(array, np.ndarray):
                raise TypeError(f"{type(array).__name__} cannot be left in a shared room")
            order = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
            start, end = end, end + -(-array.nbytes // _ALIGNED) * _ALIGNED
            if end > self.size:
                raise MemoryError(f"a message of more than {self.size} bytes")
            place = [array.dtype.str, list(array.shape), order, start]
            self._at(place)[...] = array
            return {_ARRAY: place}

        return json.dumps(content, default=placed).encode()

    def opened(self, message: bytes) -> Content:
        """What a message says, with arrays of its own."""

        def taken(known: dict[str, Any]) -> Content:
            return self._at(known[_ARRAY]).copy(order="K") if _ARRAY in known else known

        return json.loads(message, object_hook=taken)

    def _at(self, place: list[Any]) -> np.ndarray[Any, np.dtype[Any]]:
        dtype, shape, order, start = place
        return np.ndarray(shape, dtype, self._memory, start, order=order)

    def close(self) -> None:
        """Give it back."""
        self._memory.close()
