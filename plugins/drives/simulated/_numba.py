"""The decorators of every compiled function here; they do nothing but fix numba's settings.

numba keeps compiled code on disk and looks only at the one source file that a function is in: a
change in another module that is compiled into it would go unseen. So the name under which a
function is kept carries a fingerprint of all compiled modules.
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
    """Compile in nopython mode, cached on disk, without the interpreter's lock."""
    return _compiled(function, forceinline=False)


def inlined(function: F) -> F:
    """The same for what the step loop is made of: a call there would cost more than what is called."""
    return _compiled(function, forceinline=True)


def _compiled(function: F, *, forceinline: bool) -> F:
    function.__qualname__ = f"{function.__qualname__}_{_fingerprint()}"
    decorate = njit(cache=True, nogil=True, error_model="numpy", forceinline=forceinline)
    return cast(F, decorate(function))
