"""One thread for the linear algebra, for as long as something is computed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread() -> Iterator[None]:
    """Ask the BLAS libraries for one thread while the block, or the decorated function, lasts.

    Their threads wait for each other by spinning, which costs many times more than they bring to matrices as small as
    these: an estimation on two busy cores took four times the processor's time. Who has set ``OPENBLAS_NUM_THREADS``
    keeps it.
    """
    if "OPENBLAS_NUM_THREADS" in os.environ:
        yield
        return
    import scipy.linalg  # noqa: F401  # its own library has to be loaded to be asked
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
