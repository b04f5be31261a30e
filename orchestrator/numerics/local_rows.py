"""Triangular factor of a matrix with local rows, such as derivatives of a tensor spline."""

from __future__ import annotations

import numpy as np

from orchestrator.numerics.types import Array


def triangular_factor(rows: Array, block: int) -> Array:
    """R of the QR decomposition of a matrix each of whose rows concerns a few neighbouring blocks of columns.

    Householder's reflections act on one block of columns after another (A. Bjorck, Numerical Methods for Least Squares
    Problems, 1996, section 6.3, doi:10.1137/1.9781611971484), which takes a small part of a dense decomposition's time.

    Parameters
    ----------
    rows : array, shape (m, n)
    block : int
        Number of columns of a block; n is a multiple of it.

    Returns
    -------
    array, shape (n, n)
        Upper triangular, with R^T R = rows^T rows; the signs of its rows are arbitrary.
    """
    width = rows.shape[1]
    used = np.asarray(rows.reshape(len(rows), -1, block).any(axis=2))
    blocks = used.shape[1]
    first, end = used.argmax(axis=1), (blocks - used[:, ::-1].argmax(axis=1)) * block
    out, left = np.zeros((width, width)), np.zeros((0, 0))
    for k in range(blocks):
        begin, here = k * block, first == k
        stop = max(begin + max(left.shape[1], block), int(end[here].max(initial=0)))
        wider = np.pad(left, ((0, 0), (0, stop - begin - left.shape[1])))
        r = np.asarray(np.linalg.qr(np.concatenate([wider, rows[here][:, begin:stop]]), mode="r"))
        out[begin : begin + min(block, len(r)), begin:stop] = r[:block]
        left = r[block:, block:]
    return out
