"""Decorators of the compiled functions, which fix numba's settings.

numba caches compiled code on disk and checks only the source file of the function itself, not the
modules that are compiled into it. So the name under which a function is cached includes a
fingerprint of all compiled modules.
"""

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


@cache
def _fingerprint() -> str:
    digest = sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        source = path.read_bytes()
        if b"._numba import" in source or path.stem == "_state":  # constants of the layout are compiled in
            digest.update(source)
    return digest.hexdigest()[:12]


def kernel(function: F) -> F:
    """Compile in nopython mode, cached on disk, releasing the interpreter's lock."""
    return _compiled(function, forceinline=False)


def inlined(function: F) -> F:
    """As `kernel`, always inlined: in the step loop a call would cost more than the function itself."""
    return _compiled(function, forceinline=True)


def _compiled(function: F, *, forceinline: bool) -> F:
    function.__qualname__ = f"{function.__qualname__}_{_fingerprint()}"
    decorate = njit(cache=True, nogil=True, error_model="numpy", forceinline=forceinline)
    return cast(F, decorate(function))
