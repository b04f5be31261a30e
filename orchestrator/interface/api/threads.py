"""One thread for the linear algebra during a computation."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit the BLAS libraries to one thread while the block, or the decorated function, lasts.

    Their threads wait for each other by spinning, which costs far more than they gain with matrices as small as these:
    an estimation on two busy cores took four times the processor's time. ``OPENBLAS_NUM_THREADS`` takes precedence.
    """
    if "OPENBLAS_NUM_THREADS" in os.environ:
        yield
        return
    import scipy.linalg  # noqa: F401  # its own library has to be loaded to be limited
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
