# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Storage of a supernodal factor and the calls into the compiled routines."""

# otherwise the annotations of the function inside `factorize` are evaluated at every call: 8 us, 4 % of a solve of 77 nodes
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...threads import POOL, available_threads
from . import selected_inverse, supernodal, triangular
from .parallel import divide
from .symbolic import Layout, stacks


class MultifrontalStore:
    """Panels, stack and scratch of one factorisation, all allocated once."""

    def __init__(self, layout: Layout) -> None:
        parts = available_threads()
        part = divide(layout.first, layout.row_start, layout.child_start, layout.children, parts)
        if part.any():
            tree = (layout.first, layout.row_start, layout.child_start, layout.children)
            stack_start, stack_size = stacks(*tree, part)
            layout = layout._replace(stack_start=stack_start, stack_size=stack_size)
        self._members = [np.flatnonzero(part == k) for k in range(int(part.max()) + 1)]
        self.layout = layout
        n = layout.order.size
        self.x = np.empty(int(layout.panel_start[-1]))
        self.stack = np.empty(layout.stack_size)
        self.limits = np.empty(3 * n)
        self.run = np.empty(layout.tallest // 3 + 1, np.int64)
        self.work = np.empty(layout.tallest)
        self.b = np.empty(3 * n)
        self.z: NDArray[np.float64] | None = None

    def factorize(self, values: NDArray[Any], tolerance: float, damping: float) -> int:
        """Bad pivot (scalar, elimination order), or -1."""

        def factorize(members: NDArray[Any], run: NDArray[Any]) -> int:
            scratch = (self.x, self.stack, self.limits, run, tolerance, damping)
            return supernodal.factorize(values, self.layout, members, *scratch)

        first, *others = self._members
        if not others:
            return factorize(first, self.run)
        waiting = [POOL.executor().submit(factorize, members, np.empty_like(self.run)) for members in others[:-1]]
        bad = [factorize(first, self.run), *(future.result() for future in waiting)]
        # the first bad pivot in the order of elimination, as on one thread
        if max(bad) >= 0:
            return min(pivot for pivot in bad if pivot >= 0)
        return factorize(others[-1], self.run)

    def log_determinant(self) -> float:
        """log det Omega, from the diagonal of L, which is stored inverted."""
        t = self.layout
        width = 3 * np.diff(t.first).astype(np.int64)
        ld = width + (3 * np.diff(t.row_start) + 3 & ~3)
        column = np.arange(width.sum()) - np.repeat(np.cumsum(width) - width, width)
        return -2.0 * float(
            np.log(self.x[np.repeat(t.panel_start[:-1], width) + column * np.repeat(ld + 1, width)]).sum()
        )

    def solve(self, rhs: NDArray[Any], out: NDArray[Any]) -> bool:
        """One right-hand side, flat (3n,); returns whether it is finite."""
        t = self.layout
        tree = (t.order, t.first, t.row_start, t.rows, t.panel_start)
        return triangular.solve(*tree, self.x, rhs, out, self.b, self.work)

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
        block, turned = np.empty((3, 3)), t.position[i] < t.position[j]
        if not selected_inverse.stored_block(*((j, i) if turned else (i, j)), t, self.z, block):
            return None
        return block.T if turned else block

    def inverse_pairs(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """The blocks (E, 3, 3) between pairs of nodes if they lie on the pattern of L; ``invert`` has run."""
        out = np.empty((first.size, 3, 3))
        return out if selected_inverse.stored_pairs(first, second, self.layout, self.z, out) else None

    def inverse_blocks(self, nodes: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """The blocks (k, 3, k, 3) between all pairs of nodes if they lie on the pattern of L; ``invert`` has run."""
        out = np.empty((nodes.size, 3, nodes.size, 3))
        return out if selected_inverse.stored_blocks(nodes, self.layout, self.z, out) else None
