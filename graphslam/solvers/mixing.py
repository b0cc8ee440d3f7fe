"""Anderson acceleration of an iteration x -> g(x) that converges linearly.

With state-dependent information re-evaluated at every step, Gauss-Newton is such an iteration. Measured rates range from
0.4 (3-D sensor) to 0.97 (2-D sensor); at 0.97 plain steps need about 700 iterations to reach 1e-9, mixed ones about 30.
"""

from __future__ import annotations

import numpy as np

from ..se2 import Array


class AndersonMixing:
    """Anderson mixing of the last iterates (type II), with a restart where it does not help.

    With f = g(x) - x and the differences dX, dF of the last ``depth`` iterates, gamma = argmin |f - dF gamma| gives the
    next iterate x + f - (dX + dF) gamma. A fixed point of g stays one.

    Source: Anderson, *Iterative procedures for nonlinear integral equations*, J. ACM 12 (1965); Walker and Ni,
    *Anderson acceleration for fixed-point iterations*, SIAM J. Numer. Anal. 49 (2011).
    """

    def __init__(self, *, depth: int = 8, begin_below: float = 0.1) -> None:
        """Mix the last ``depth`` iterates once the root mean square of f is below ``begin_below``: g is nearly linear."""
        self.depth, self.begin_below = depth, begin_below
        self._x: list[Array] = []
        self._f: list[Array] = []

    @property
    def active(self) -> bool:
        """Whether the last iterate was mixed."""
        return len(self._x) > 1

    def next(self, x: Array, f: Array) -> Array:
        """The next iterate, from x and f = g(x) - x (same shape)."""
        with np.errstate(over="ignore"):  # an infinite mean is far from linear, too
            rms = float(np.sqrt(np.mean(f * f)))
        if rms > self.begin_below or (self._f and rms > 2 * float(np.sqrt(np.mean(self._f[-1] ** 2)))):
            self._x, self._f = [], []
            return x + f
        self._x, self._f = [*self._x[-self.depth :], x.ravel()], [*self._f[-self.depth :], f.ravel()]
        if len(self._x) < 2:
            return x + f
        dx, df = np.diff(self._x, axis=0).T, np.diff(self._f, axis=0).T
        gamma, *_ = np.linalg.lstsq(df, f.ravel(), rcond=1e-10)
        return x + f - ((dx + df) @ gamma).reshape(x.shape)
