"""Move the whole trajectory and map at once along the directions in which the log determines them least.

Pivots and stretches change a few poses at a time. A long log holds each of them tightly, while its whole trajectory may still
shift, turn and bend by much more: it then takes them very many small steps. Here the posterior of trajectory and map is
approximated by a Gaussian N(s, (J' J)^-1) at its mode s, as graph SLAM does. Its r widest directions, the columns of V with
standard deviations d, are independent of all others under the Gaussian. Their coordinates a are proposed anew,

    a' = sqrt(1 - b²) a + b n,    n ~ N(0, I),

which leaves the Gaussian unchanged, and accepted with the probability exp(F(before) - F(after)), F = -log posterior + log
Gaussian. So the target is exact, whatever the Gaussian. The step b is adapted in the warm-up and fixed afterwards.

Source: Cotter, Roberts, Stuart and White, *MCMC methods for functions: modifying old algorithms to make them faster*,
Statistical Science 2013 (preconditioned Crank-Nicolson); Cui, Law and Marzouk, *Dimension-independent likelihood-informed
MCMC*, Journal of Computational Physics 2016, for a subspace.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, log1p, sqrt

import numpy as np
import scipy.sparse as sp
from numba import njit
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from graphslam.errors import OptionError
from graphslam.se2 import Array, between, wrap

from ..fast_math import OPTIONS, wrap_angle
from ..options import GibbsOptions
from .maps import off, relative, six, squared, three
from .sightings import Problem

#: the most directions, and the share of all dimensions
DIRECTIONS, SHARE = 150, 0.5
#: moves after each sweep, and the share that should be accepted
MOVES, ACCEPTED = 15, 0.3
#: Gauss-Newton steps to the mode
FITS = 20
#: up to this size all eigenvectors are computed
DENSE = 300


@dataclass(frozen=True, eq=False)
class Target:
    """-log of the posterior of a trajectory and a map, without constants, with precisions of the sightings integrated out.

    Attributes:
        degrees: of freedom of Student's t distribution of the sightings; 0 for a Gaussian.
        exact: whether the sightings have the density of range and bearing, or the linearised one.
        weights: (K, 6) upper triangles of the information of the linearised sightings; without psi nothing of the headings.
        steps: (K,) of the sightings.
    """

    problem: Problem
    degrees: float
    exact: bool
    weights: Array
    steps: np.ndarray

    @classmethod
    def of(cls, problem: Problem, options: GibbsOptions) -> Target:
        """Return that of a problem."""
        n, W = problem.columns, np.zeros((len(problem.C), 3, 3))
        W[:, :n, :n] = np.linalg.inv(full(problem.C)[:, :n, :n])
        rows, columns = np.triu_indices(3)
        weights = np.ascontiguousarray(W[:, rows, columns])
        return cls(problem, options.degrees_of_freedom or 0.0, options.density == "exact", weights, problem.steps)

    def __call__(self, poses: Array, marks: Array, squares: Array | None = None) -> float:
        """Return its value; ``squares`` (K,) receives e' C^-1 e of the sightings."""
        return self._value(poses, marks, squares, self.exact)

    def linearised(self, poses: Array, marks: Array, squares: Array | None = None) -> float:
        """The same with the linearised density."""
        return self._value(poses, marks, squares, False)

    def _value(self, poses: Array, marks: Array, squares: Array | None, exact: bool) -> float:
        p = self.problem
        return _cost(
            poses, marks, p.motions, p.information, self.steps, p.marks, p.y, self.weights, p.z, p.q, p.columns, self.degrees,
            exact, np.empty(len(p.z)) if squares is None else squares,
        )  # fmt: skip


class Bends:
    """The Gaussian at the mode of a target, and its widest directions.

    A state is a vector of 3 T + n J numbers: the poses after the first, and the n numbers of each landmark. Without psi n is
    2: nothing depends on the headings of landmarks, so that they must not be among the directions of the Gaussian.

    Args:
        target: of the moves. The Gaussian is that of its linearised density.
        poses, marks: (T + 1, 3) and (J, 3), where the search for the mode begins.

    Attributes:
        target: as given.
    """

    def __init__(self, target: Target, poses: Array, marks: Array) -> None:
        self.target = target
        x, m = self._mode = mode(target, poses, marks)
        J, _ = linear(target, x, m)
        information = (J.T @ J).tocsc()
        size = information.shape[0]
        self._headings = np.arange(2, size if target.problem.columns == 3 else 3 * (len(x) - 1), 3)
        r = min(DIRECTIONS, int(SHARE * size))
        if size <= DENSE:
            values, V = np.linalg.eigh(information.toarray())
            self._V, self._d = np.ascontiguousarray(V[:, :r]), values[:r] ** -0.5
        else:
            inverse = LinearOperator((size, size), matvec=splu(information).solve)
            values, self._V = eigsh(inverse, k=r, v0=np.ones(size))
            self._d = np.sqrt(values)

    def renew(self, rng: np.random.Generator, poses: Array, marks: Array, step: float) -> tuple[Array, Array, float]:
        """Return a state after `MOVES` moves with the step b = ``step``, and the share of them that was accepted."""
        x, m = self._mode
        away = self._away(poses - x, marks - m)
        a = (self._V.T @ away) / self._d
        value, accepted = self.target(poses, marks) - 0.5 * float(a @ a), 0
        for _ in range(MOVES):
            proposed = np.sqrt(1 - step * step) * a + step * rng.standard_normal(len(a))
            move = self._V @ (self._d * (proposed - a))
            reached = away + move
            # half a turn from the mode, the way back would begin at other coordinates: such moves are rejected
            if np.any(np.abs(reached[self._headings]) > np.pi):
                continue
            trial = displaced(poses, marks, move)
            excess = self.target(*trial) - 0.5 * float(proposed @ proposed)
            if np.log(rng.random()) < value - excess:
                (poses, marks), away, a, value = trial, reached, proposed, excess
                accepted += 1
        return poses, marks, accepted / MOVES

    def _away(self, poses: Array, marks: Array) -> Array:
        """The vector of a difference of two states."""
        n = self.target.problem.columns
        for part in (poses, marks):
            part[:, 2] = wrap(part[:, 2])
        return np.concatenate([poses[1:].ravel(), marks[:, :n].ravel()])


def mode(target: Target, poses: Array, marks: Array) -> tuple[Array, Array]:
    """Return poses and landmarks at the mode of the linearised density: damped Gauss-Newton steps from where they are."""
    x, m = poses.copy(), marks.copy()
    lowest, damping = target.linearised(x, m), 1e-9
    for _ in range(FITS):
        J, e = linear(target, x, m)
        information = (J.T @ J).tocsc()
        damped = information + sp.diags_array(damping * information.diagonal(), format="csc")
        trial = displaced(x, m, splu(damped).solve(-J.T @ e))
        value = target.linearised(*trial)
        if not value < lowest:
            damping = max(100 * damping, 1e-6)
            continue
        done = lowest - value < 1e-6
        (x, m), lowest, damping = trial, value, max(damping / 10, 1e-9)
        if done:
            break
    return x, m


def displaced(poses: Array, marks: Array, step: Array) -> tuple[Array, Array]:
    """Return poses and landmarks plus a displacement (3 T + n J,) of all but the first pose."""
    x, m, after = poses.copy(), marks.copy(), 3 * (len(poses) - 1)
    x[1:] += step[:after].reshape(-1, 3)
    moved = step[after:].reshape(len(marks), -1)
    m[:, : moved.shape[1]] += moved
    x[:, 2], m[:, 2] = wrap(x[:, 2]), wrap(m[:, 2])
    return x, m


def full(upper: Array) -> Array:
    """Symmetric matrices (k, 3, 3) from their upper triangles (k, 6)."""
    return upper[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]


@njit(**OPTIONS)
def _cost(
    x: Array, m: Array, motions: Array, information: Array, steps: np.ndarray, marks: np.ndarray, y: Array,
    weights: Array, z: Array, q: Array, columns: int, degrees: float, exact: bool, squares: Array,
) -> float:  # fmt: skip
    total = 0.0
    for t in range(len(motions)):
        d = relative(three(x[t]), three(x[t + 1]))
        total += squared(six(information[t], 0), off(three(motions[t]), d))
    for k in range(len(z)):
        place = relative(three(x[steps[k]]), three(m[marks[k]]))
        if exact:
            bearing = atan2(place[1], place[0])
            e0 = z[k, 0] - sqrt(place[0] * place[0] + place[1] * place[1])
            e1, e2 = wrap_angle(z[k, 1] - bearing), wrap_angle(z[k, 2] - bearing + place[2])
            value = e0 * e0 / q[k, 0] + e1 * e1 / q[k, 1] + (e2 * e2 / q[k, 2] if columns == 3 else 0.0)
        else:
            value = squared(six(weights[k], 0), off(three(y[k]), place))
        squares[k] = value
        total += (degrees + columns) * log1p(value / degrees) if degrees > 0.0 else value
    return 0.5 * total


def linear(target: Target, poses: Array, marks: Array) -> tuple[sp.csr_array, Array]:
    """Return the whitened Jacobian (rows, 3 T + n J) and residuals.

    Student's sightings are weighed by (nu + n) / (nu + e' C^-1 e).
    """
    p, steps = target.problem, target.steps
    T, J = len(poses) - 1, len(marks)
    W = full(target.weights)
    if target.degrees > 0:
        squares = np.empty(len(W))
        target.linearised(poses, marks, squares)
        W = ((target.degrees + p.columns) / (target.degrees + squares))[:, None, None] * W
    # without psi, so that W has a root; the row and the column are left out below
    W[:, 2, 2] += p.columns == 2
    starts = np.concatenate([poses[:-1], poses[steps]])
    d = between(starts, np.concatenate([poses[1:], marks[p.marks]]))
    e = d - np.concatenate([p.motions, p.y])
    e[:, 2] = wrap(e[:, 2])
    try:
        root = np.swapaxes(np.linalg.cholesky(np.concatenate([full(p.information), W])), 1, 2)
    except np.linalg.LinAlgError:
        raise OptionError(
            "a motion or a sighting has a covariance without an inverse in floating point: look for a wrong range (the "
            f"longest is {p.z[:, 0].max():.3g} m), or raise epsilon of the motion"
        ) from None
    c, s = np.cos(starts[:, 2]), np.sin(starts[:, 2])
    zero, one = np.zeros_like(c), np.ones_like(c)
    A = np.moveaxis(np.array([[-c, -s, d[:, 1]], [s, -c, -d[:, 0]], [zero, zero, -one]]), -1, 0)
    B = np.moveaxis(np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]]), -1, 0)
    first = np.concatenate([np.arange(T), steps]) - 1
    second = np.concatenate([np.arange(T), T + p.marks])
    rows = 3 * np.arange(len(first))[:, None, None] + np.arange(3)[:, None] + np.zeros((1, 1, 3), np.int64)
    parts = []
    for at, block in ((first, root @ A), (second, root @ B)):
        columns = 3 * at[:, None, None] + np.arange(3) + np.zeros((1, 3, 1), np.int64)
        # the first pose is known
        known = at >= 0
        parts.append((block[known].ravel(), rows[known].ravel(), columns[known].ravel()))
    values, row, column = (np.concatenate(part) for part in zip(*parts, strict=True))
    whitened = (root @ e[..., None])[..., 0].ravel()
    jacobian = sp.csr_array((values, (row, column)), shape=(3 * len(first), 3 * (T + J)))
    if p.columns == 2:
        counts = [(np.arange(size) < 3 * T) | (np.arange(size) % 3 < 2) for size in jacobian.shape]
        jacobian, whitened = jacobian[counts[0]][:, counts[1]], whitened[counts[0]]
    return jacobian, whitened
