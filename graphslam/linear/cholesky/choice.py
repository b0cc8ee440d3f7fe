# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""The order of elimination: minimum degree, or nested dissection where the factorisation then takes fewer flops."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .dissection import dissect
from .elimination import elimination_tree
from .low_degree import eliminate_low_degree, remaining, twin_lists
from .ordering import amd, dense_limit, joined, minimum_degree
from .symbolic import costs, inverse, permuted_lists

#: Dissection is tried in graphs of so many nodes where minimum degree leaves so many flops for each node and entry of the
#: adjacency lists. Dissection and the order inside the parts take 0.3 µs for each of these, and save a third of the flops
#: where maps grow in both directions, in each of about five factorisations at 50 Gflop/s.
SMALLEST, WORTH = 5_000, 10_000.0


@njit(cache=True, error_model="numpy")
def flops_of(n, indptr, indices, order):
    """The flops of the factorisation in an order."""
    row_pointer, columns = permuted_lists(n, indptr, indices, inverse(order))
    _, count = elimination_tree(n, row_pointer, columns)
    return costs(count)[1]


@njit(cache=True, error_model="numpy")
def dissected(n, indptr, indices, limit):
    """The order (n,) by nested dissection; nodes with more than ``limit`` neighbours go last."""
    start, graph, twin = twin_lists(n, indptr, indices)
    head, gone, length = eliminate_low_degree(n, start, graph, twin)
    nodes, pointer, neighbours = remaining(gone, start, length, graph)
    depth = dissect(nodes.size, pointer, neighbours, limit)
    turn, deepest = np.zeros(nodes.size, np.int32), depth.max() if nodes.size else 0
    for k in range(nodes.size):
        turn[k] = deepest + 1 - depth[k] if depth[k] >= 0 else 0
    return joined(head, nodes, minimum_degree(nodes.size, pointer, neighbours, limit, turn))


def fill_reducing(
    indptr: NDArray[Any], indices: NDArray[Any], *, smallest: int = SMALLEST, worth: float = WORTH
) -> NDArray[np.int32]:
    """An elimination order (n,) for the pattern of `amd`: approximate minimum degree, or nested dissection if it is better.

    Both begin with the nodes of degree two and less. The parts of a dissection are ordered by minimum degree together with
    the separators around them, and each separator likewise. Which is better is counted on the structure of L.

    Args:
        indptr: (n+1,) column pointers of the upper triangle.
        indices: (nnzb,) row nodes.
        smallest: the number of nodes from which on dissection is tried,
        worth: and the flops of the order by minimum degree for each node and adjacency entry.
    """
    n = indptr.size - 1
    order = amd(indptr, indices)
    if n < smallest:
        return order
    pattern = n, np.ascontiguousarray(indptr, np.int64), np.ascontiguousarray(indices, np.int32)
    flops = flops_of(*pattern, order)
    if flops < worth * (2 * indices.size - n):
        return order
    other = dissected(*pattern, dense_limit(n))
    return other if flops_of(*pattern, other) < flops else order
