"""Finite differences, for what is to be a derivative."""

import numpy as np


def differentiate(function, at, step=2e-4):
    """Five-point central differences along a last axis; exact but for the fifth derivative."""
    columns = []
    for i in range(len(at)):
        h = np.zeros(len(at))
        h[i] = step
        near, far = (function(at + k * h) - function(at - k * h) for k in (1, 2))
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


def assert_close(analytic, differences):
    scale = np.abs(differences).max()
    np.testing.assert_allclose(analytic, differences, rtol=1e-7, atol=1e-8 * scale + 1e-8)


def extrapolated_slopes(function, at, step):
    """Differentiate ``function((..., p)) -> (..., n)`` by each of p numbers, shape ``(n, p)``.

    Central differences over ever smaller steps, extrapolated to none (Richardson), each entry where
    two extrapolations agree best; and how far it may be off, by that and by rounding.
    """
    sizes = step * 0.5 ** np.arange(8)
    moves = sizes[:, None, None] * np.eye(len(at))
    high, low = function(at + moves), function(at - moves)
    rows = (high - low) / (2 * sizes[:, None, None])
    rounding = 1e-15 * np.abs(high).max(axis=-1, keepdims=True) / sizes[:, None, None]
    best, error = rows[0], np.full(rows[0].shape, np.inf)
    for order in range(1, len(sizes)):
        finer = (4**order * rows[1:] - rows[:-1]) / (4**order - 1)
        apart = np.maximum(np.abs(finer - rows[1:]), np.abs(finer - rows[:-1]))
        for value, off in zip(finer, apart + rounding[order:], strict=True):
            best, error = np.where(off < error, value, best), np.minimum(off, error)
        rows = finer
    return best.T, error.T
