# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Storage of a supernodal factor and the calls into the compiled routines."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from . import selected_inverse, supernodal, triangular
from .symbolic import Layout


@njit(cache=True, error_model="numpy")
def _null_vector(bad, layout, x, b, work):
    """L' b = unit of column ``bad`` over the columns in front of it; b (3n,) comes in as zero."""
    first, row_start, panel_start = layout.first, layout.row_start, layout.panel_start
    s = np.searchsorted(first, bad // 3, side="right") - 1
    head = 3 * first[s]
    width = 3 * (first[s + 1] - first[s])
    r = 3 * (row_start[s + 1] - row_start[s])
    ld = width + ((r + 3) & ~3)
    at = panel_start[s]
    b[bad] = 1.0
    # the unfinished supernode column by column; the diagonal of L is stored inverted
    for j in range(bad - head - 1, -1, -1):
        total = 0.0
        for i in range(j + 1, bad - head + 1):
            total += x[at + j * ld + i] * b[head + i]
        b[head + j] = -total * x[at + j * (ld + 1)]
    triangular.backward(first, row_start, layout.rows, panel_start, x, b, work, s)


class MultifrontalStore:
    """Panels, stack and scratch of one factorisation, all allocated once."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        n = layout.order.size
        self.x = np.empty(int(layout.panel_start[-1]))
        self.stack = np.empty(layout.stack_size)
        self.limits = np.empty(3 * n)
        self.run = np.empty(layout.tallest // 3 + 1, np.int64)
        self.work = np.empty(layout.tallest)
        self.b = np.empty(3 * n)
        self.z: NDArray[np.float64] | None = None

    def factorize(self, values: NDArray[Any], tolerance: float, scaled: float, shift: float) -> int:
        """Bad pivot (scalar, elimination order), or -1."""
        t = self.layout
        return supernodal.factorize(
            values,
            t.first,
            t.row_start,
            t.relative,
            t.child_start,
            t.children,
            t.panel_start,
            t.stack_start,
            t.entry_start,
            t.entry_source,
            t.entry_target,
            self.x,
            self.stack,
            self.limits,
            self.run,
            tolerance,
            scaled,
            shift,
        )

    def null_vector(self, bad: int) -> NDArray[np.float64]:
        """Null vector (n, 3) in node order after a bad pivot."""
        t = self.layout
        b = np.zeros(self.b.size)
        _null_vector(bad, t, self.x, b, self.work)
        out = np.empty((t.order.size, 3))
        out[t.order] = b.reshape(-1, 3)
        return out

    def pivot_place(self, bad: int) -> tuple[int, int]:
        """Node and component of a scalar pivot."""
        return int(self.layout.order[bad // 3]), bad % 3

    def solve(self, rhs: NDArray[Any], out: NDArray[Any]) -> None:
        """One right-hand side, flat (3n,)."""
        t = self.layout
        triangular.solve(t.order, t.first, t.row_start, t.rows, t.panel_start, self.x, rhs, out, self.b, self.work)

    def invert(self) -> NDArray[np.float64]:
        """Selected inverse; returns the diagonal blocks (n, 3, 3)."""
        t = self.layout
        if self.z is None:
            self.z = np.empty_like(self.x)
            self._front = np.empty((t.tallest * t.tallest,))
            self._y = np.empty(selected_inverse.BLOCK * t.tallest)
            self._transposed = np.empty(selected_inverse.BLOCK * t.tallest)
            self._gram = np.empty(selected_inverse.BLOCK * selected_inverse.BLOCK)
        diagonal = np.empty((t.order.size, 3, 3))
        scratch = (self._front, self._y, self._transposed, self._gram)
        selected_inverse.selected_inverse(t, self.x, self.z, self.stack, self.run, *scratch, diagonal)
        return diagonal

    def inverse_block(self, i: int, j: int) -> NDArray[np.float64] | None:
        """Block (i, j) of the inverse if it lies on the pattern of L; ``invert`` has run."""
        t = self.layout
        block = np.empty((3, 3))
        return block if selected_inverse.stored_block(i, j, t, self.z, block) else None
