"""`LandmarkMap`: where landmarks are, and how well that is known."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from os import PathLike
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ..errors import FormatError, OptionError, quoted
from ..errors.checks import array_of, check_choice, check_heading, finite_numbers, singular
from ..files import path_of
from ..log.measurements import same
from ..log.rows import NO_ID, UNIDENTIFIED
from ..se2 import Array, wrap
from .map_files import read_map, write_map

#: how a map is used: as its covariances say, without their correlations between landmarks, or as exact
USES = ("joint", "own", "fixed")
#: what is said of a map that is `correlated`
CORRELATIONS_LOST = (
    "the map lacks the correlations between its landmarks, which share errors, so that poses in it are less exact than their "
    "covariances say: only .npz files keep them, and the maps of very large graphs have none. Use the .npz file of this map, "
    "or of a smaller graph of the same log"
)
#: the standard deviation [m, rad] of places and headings that are exact, where they need one
HELD_STD = 1e-5
#: the largest asymmetry and negative eigenvalue of a covariance that count as rounding, over its size
ROUNDED = 1e-9
#: the least root of a pivot of a correlation matrix whose inverse is not lost in rounding
LEAST_PIVOT = 1e-7


class LandmarkMap(dict[int, Array]):
    """{id: (x, y) or (x, y, heading)} [m, m, rad], with what is known about the errors of these places.

    A landmark without a covariance is exact: `Graph.from_log` with this map holds it where it is. One with a covariance has
    it as a prior. With ``joint`` the priors are those of all these landmarks together, with their correlations.

    Args:
        means: the places; headings are wrapped to [-pi, pi).
        covariances: {id: (2, 2) or (3, 3)} of some or all landmarks; not given where ``joint`` is.
        classes: {id: word or number}, what landmarks look like, where that is known. "1" and 1.0 become the number 1, because
            files do not distinguish them.
        joint: (N, N), the covariance of the coordinates of landmarks together, in increasing order of the ids ``joint_ids``.
        joint_ids: the ids of these landmarks; default: all.
        correlated: whether the errors of landmarks are correlated in a way that the covariances do not say, as in a file
            other than .npz of an estimated map. `Graph.from_log` and `OnlineSolver` have a note on it.
        datum: (3,) latitude and longitude [degrees, WGS 84] and height [m] of the origin of the map, of which places are
            metres east and north; default: not known. Absolute positions of a log are given from there.

    Raises:
        OptionError: an id, a place or a covariance is impossible.
    """

    def __init__(
        self,
        means: Mapping[int, ArrayLike],
        covariances: Mapping[int, ArrayLike] | None = None,
        *,
        classes: Mapping[int, str | int] | None = None,
        joint: ArrayLike | None = None,
        joint_ids: Iterable[int] | None = None,
        correlated: bool = False,
        datum: ArrayLike | None = None,
    ) -> None:
        if not isinstance(means, Mapping):
            raise OptionError(f"a map is a mapping {{id: (x, y) or (x, y, heading)}}, not {quoted(means)}")
        super().__init__({_id(j): _place(j, place) for j, place in sorted(means.items())})
        self.classes: dict[int, str | int] = {j: _class(kind) for j, kind in (classes or {}).items() if j in self}
        self.joint: Array | None = None
        self.datum = None if datum is None else finite_numbers("the datum of the map", datum, (3,))
        given = {} if covariances is None else covariances
        if not isinstance(given, Mapping):
            raise OptionError(
                f"covariances of a map are {{id: (2, 2) or (3, 3)}}, one for each landmark, not {quoted(given)}"
            )
        if given and joint is not None:
            raise OptionError("give covariances of single landmarks or a joint covariance, not both")
        chosen = list(given) if joint is None else sorted(self if joint_ids is None else set(joint_ids))
        self.correlated = correlated and bool(chosen)
        if unknown := [j for j in chosen if j not in self]:
            raise OptionError(f"there is a covariance of landmark {unknown[0]}, which is not in the map")
        if joint is None:
            self.covariances = {j: _covariance(j, given[j], len(self[j])) for j in self if j in given}
            return
        ends = np.cumsum([0, *(len(self[j]) for j in chosen)])
        matrix = array_of("joint", joint)
        if matrix.shape != (ends[-1], ends[-1]):
            shape = f"({ends[-1]}, {ends[-1]}), a row for each coordinate of its landmarks"
            raise OptionError(f"the joint covariance must have shape {shape}, not {matrix.shape}")
        self.joint = _checked("the joint covariance of the map", matrix)
        self.covariances = {j: self.joint[a:b, a:b] for j, a, b in zip(chosen, ends, ends[1:])}

    @classmethod
    def of_estimate(cls, means: Mapping[int, Array], covariances: Mapping[int, Array]) -> LandmarkMap:
        """The map of numbers that a solver has made, which need no check; by increasing id."""
        made = cls.__new__(cls)
        dict.__init__(made, means)
        made.covariances, made.classes, made.joint = dict(covariances), {}, None
        made.correlated, made.datum = False, None
        return made

    @classmethod
    def load(cls, path: str | PathLike[str]) -> LandmarkMap:
        """The map of a file: .npz, a table (.csv, .tsv, .txt, .parquet), YAML of tags, or GeoJSON; see `maps.map_files`.

        Only .npz has the joint covariance of an estimated map, see `save`.

        Raises:
            FormatError: the file cannot be read, or holds no map or impossible covariances; with the line where one is
                the cause.
        """
        path = path_of(path)
        parts = read_map(path)
        try:
            return cls(**parts)
        except OptionError as error:
            raise FormatError(path, None, str(error)) from None

    def save(self, path: str | PathLike[str]) -> None:
        """Write the map in the format of the name's ending: .npz keeps everything, the others no joint covariance.

        The others say that it is lost (`correlated`). Without it, errors that landmarks have in common count as if each had
        its own, so that poses in the map are too sure: the mean squared Mahalanobis distance over their dimension is 2.4 with
        a map as .csv, .yaml or .geojson, 1.1 as .npz.

        Raises:
            OptionError: there is no format with this ending.
            FormatError: the file cannot be written.
        """
        # a landmark may have been taken out like any other entry of a dictionary
        write_map(path_of(path), self.among(self))

    def copy(self) -> LandmarkMap:
        """A map of its own, with what is known of the errors."""
        return deepcopy(self)

    def __eq__(self, other: object) -> bool:
        """Whether the other one has exactly the same places and says the same of their errors."""
        return type(other) is type(self) and same(dict(self), dict(other)) and same(vars(self), vars(other))

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __repr__(self) -> str:
        """One line: sizes, and what is known of the errors."""
        exact = len(self) - len(self.covariances)
        parts = [f"{len(self.covariances)} with {'a joint covariance' if self.joint is not None else 'covariances'}"]
        parts = parts * bool(self.covariances) + [f"{exact} exact"] * bool(exact)
        return singular(f"<LandmarkMap of {len(self)} landmarks{': ' * bool(parts)}{', '.join(parts)}>")

    @property
    def oriented(self) -> bool:
        """Whether the heading of every landmark is known."""
        return all(len(place) == 3 for place in self.values())

    def used_as(self, use: str) -> LandmarkMap:
        """The map with less said about its errors.

        Args:
            use: "joint", the joint covariance; "own", that of each landmark without correlations; "fixed", all exact. With
                "own" and "fixed", covariances and `integrity_risk` of poses are too small where errors are shared.

        Raises:
            OptionError: there is no such use.
        """
        check_choice("map_use", use, USES)
        if use == "joint":
            return self
        return self._like(self, self.covariances if use == "own" else None)

    def _like(
        self, means: Mapping[int, ArrayLike], covariances: Mapping[int, ArrayLike] | None = None, **joint: Any
    ) -> Self:
        """A map with other means and covariances of its landmarks, and all else that this one knows of them."""
        known: dict[str, Any] = {"classes": self.classes, "correlated": self.correlated, "datum": self.datum}
        return type(self)(means, covariances, **known, **joint)

    def widened(self, deviation: float, exact: float = HELD_STD) -> LandmarkMap:
        """The map with an independent error of every coordinate of its places, with this standard deviation [m], besides.

        Exact coordinates have at least the standard deviation ``exact`` [m, rad], and headings no other error.
        """
        sizes = [len(place) for place in self.values()]
        known = np.repeat(np.array([j in self.covariances for j in self], dtype=bool), np.array(sizes, dtype=int))
        heading = np.array([coordinate == 2 for size in sizes for coordinate in range(size)], dtype=bool)
        added = np.maximum(np.where(heading, 0.0, deviation**2), np.where(known, 0.0, exact**2))
        if self.joint is not None:
            joint = np.diag(added)
            joint[np.ix_(known, known)] += self.joint
            return self._like(self, joint=joint)
        parts = zip(self, np.split(added, np.cumsum(sizes)[:-1]))
        own = {j: self.covariances.get(j, 0.0) + np.diag(variances) for j, variances in parts}
        return self._like(self, own)

    def among(self, ids: Iterable[int]) -> LandmarkMap:
        """The map of those of the ids that it has."""
        kept = sorted(set(ids) & set(self))
        means, known = {j: self[j] for j in kept}, [j for j in kept if j in self.covariances]
        if self.joint is None:
            return self._like(means, {j: self.covariances[j] for j in known})
        rows, *_ = self._in_joint(known)
        return self._like(means, joint=self.joint[np.ix_(rows, rows)], joint_ids=known)

    def updated(self, ids: Sequence[int], places: Array, covariance: Array) -> LandmarkMap:
        """The map with the places (L, d) of landmarks, new ones among them, by the solution of a graph in this map.

        Let a be the coordinates of the map that the graph has, and b the others, such as headings where d = 2, with the map's
        covariance C. What a log says of b it says by a. So where a becomes a' with the covariance P,

            b' = b + K (a' - a),    K = C_ba C_aa^-1,    cov(b') = C_bb - K C_ab + K P K',    cov(b', a') = K P.

        Args:
            covariance: (d L, d L) of the places together.
        """
        from scipy.linalg import block_diag

        d, values = places.shape[1], places.ravel()
        coordinates = [(j, c) for j in ids for c in range(d)]
        rows = {each: row for row, each in enumerate(coordinates)}
        own = [(j, c) for j, C in self.covariances.items() for c in range(len(C))]
        a, b = ([k for k, each in enumerate(own) if (each in rows) == inside] for inside in (True, False))
        if b:
            C = block_diag(*self.covariances.values()) if self.joint is None else self.joint
            before, at = np.array([self[j][c] for j, c in own]), [rows[own[k]] for k in a]
            K = np.zeros((len(b), len(values)))
            K[:, at] = np.linalg.solve(C[np.ix_(a, a)], C[np.ix_(a, b)]).T
            left, mixed = C[np.ix_(b, b)] - K[:, at] @ C[np.ix_(a, b)], K @ covariance
            covariance = np.block([[covariance, mixed.T], [mixed, left + mixed @ K.T]])
            values = np.append(values, before[b] + K[:, at] @ (values[at] - before[a]))
            coordinates += [own[k] for k in b]
        order = sorted(range(len(coordinates)), key=lambda k: coordinates[k])
        found: dict[int, list[float]] = {}
        for k in order:
            found.setdefault(coordinates[k][0], []).append(values[k])
        covariance = covariance[np.ix_(order, order)]
        return self._like({**self, **found}, joint=(covariance + covariance.T) / 2, joint_ids=found)

    def arrays(self, ids: Iterable[int]) -> tuple[Array, Array]:
        """The places (L, 3) of landmarks, headings NaN where unknown, and their covariances (L, 3, 3), zero where exact."""
        chosen = list(ids)
        places, covariances = np.full((len(chosen), 3), np.nan), np.zeros((len(chosen), 3, 3))
        for k, j in enumerate(chosen):
            places[k, : len(self[j])] = self[j]
            if j in self.covariances:
                covariances[k, : len(self[j]), : len(self[j])] = self.covariances[j]
        return places, covariances

    def _in_joint(self, ids: Sequence[int], coordinates: int = 3) -> np.ndarray:
        """The rows of ``joint`` that are of landmarks, with the places of these among ``ids`` and the coordinate: (3, N)."""
        place = {j: k for k, j in enumerate(ids)}
        each = ((j, c) for j, C in self.covariances.items() for c in range(len(C)))
        found = [(row, place[j], c) for row, (j, c) in enumerate(each) if j in place and c < coordinates]
        return np.array(found, dtype=np.int64).reshape(-1, 3).T

    def between(self, ids: Sequence[int]) -> Array:
        """The covariances (L, L, 3, 3) of landmarks from one another, zero where they are exact."""
        blocks, each = np.zeros((len(ids), len(ids), 3, 3)), np.arange(len(ids))
        blocks[each, each] = self.arrays(ids)[1]
        if self.joint is not None:
            rows, k, c = self._in_joint(ids)
            blocks[k[:, None], k, c[:, None], c] = self.joint[np.ix_(rows, rows)]
        return blocks

    def joint_covariance(self, ids: Sequence[int]) -> Array:
        """The covariance (2 L, 2 L) of the positions of landmarks together, zero where they are exact."""
        return self.between(ids)[:, :, :2, :2].transpose(0, 2, 1, 3).reshape(2 * len(ids), -1)

    def information(self, ids: Sequence[int], coordinates: int) -> Array:
        """The information (3 L, 3 L) of landmarks, ``coordinates`` of each, whatever the others are; zero for exact ones.

        Rows of coordinates that the map does not give are zero. Of a joint covariance it is the inverse of the block
        of these landmarks, that is, the Schur complement of the others.

        Raises:
            OptionError: a covariance is singular.
        """
        blocks = np.zeros((len(ids), 3, len(ids), 3))
        if self.joint is not None:
            rows, k, c = self._in_joint(ids, coordinates)
            inverse = _inverse("the joint covariance of the map", self.joint[np.ix_(rows, rows)])
            blocks[k[:, None], c[:, None], k, c] = inverse
        else:
            for k, j in enumerate(ids):
                if j in self.covariances:
                    blocks[k, :, k] = self.own_information(j, coordinates)
        return blocks.reshape(3 * len(ids), 3 * len(ids))

    def own_information(self, id: int, coordinates: int) -> Array:
        """The information (3, 3) of one landmark, zero for coordinates that the map does not give.

        Raises:
            OptionError: the covariance is singular.
        """
        known = min(len(self.covariances[id]), coordinates)
        information = np.zeros((3, 3))
        information[:known, :known] = _inverse(f"the covariance of landmark {id}", self.covariances[id][:known, :known])
        return information


def as_map(value: object) -> LandmarkMap:
    """A map given as such, as {id: place}, as the path of a file, or by what has estimated it and has it as ``map``.

    Raises:
        OptionError: it is something else. FormatError: the file holds no map.
    """
    value = getattr(value, "map", value)
    if isinstance(value, LandmarkMap):
        return value
    if isinstance(value, Mapping):
        return LandmarkMap(value)
    if isinstance(value, (str, PathLike)):
        return LandmarkMap.load(value)
    raise OptionError(f"map must be a LandmarkMap, {{id: (x, y)}} or the path of a file, not {quoted(value)}")


def _class(kind: object) -> str | int:
    """A class as the whole number that it is, or else as a word; 007 is a word."""
    number = re.fullmatch(r"(0|-?[1-9][0-9]*)(\.0*)?", word := str(kind))
    return int(number[1]) if number else word


def _id(value: object) -> int:
    value = int(value) if isinstance(value, float) and value.is_integer() else value
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or not -(2**63) <= value < 2**63:
        raise OptionError(f"the ids of a map are whole numbers of at most 64 bits, not {quoted(value)}")
    if value in (NO_ID, UNIDENTIFIED):
        raise OptionError(f"the id {value} stands for no id: give this landmark of the map another one")
    return int(value)


def _place(id: int, value: ArrayLike) -> Array:
    place = array_of(f"landmark {id} of the map", value)
    if place.shape not in ((2,), (3,)) or not np.isfinite(place).all():
        raise OptionError(f"landmark {id} of the map must be finite, (x, y) or (x, y, heading), not {quoted(value)}")
    check_heading(f"landmark {id} of the map", place[2:])
    return np.append(place[:2], wrap(place[2:]))


def _covariance(id: int, value: ArrayLike, coordinates: int) -> Array:
    name = f"the covariance of landmark {id}"
    matrix = array_of(name, value)
    if matrix.shape != (coordinates, coordinates):
        raise OptionError(f"{name} must have shape ({coordinates}, {coordinates}), not {matrix.shape}")
    return _checked(name, matrix)


def _checked(name: str, matrix: Array) -> Array:
    """A covariance, symmetric; landmarks that a solver gave may be exact in some direction."""
    size = np.abs(matrix).max(initial=0.0)
    if not np.isfinite(matrix).all() or np.abs(matrix - matrix.T).max(initial=0.0) > ROUNDED * size:
        raise OptionError(f"{name} must be a symmetric matrix of finite numbers")
    matrix = (matrix + matrix.T) / 2
    if len(matrix) and np.linalg.eigvalsh(matrix)[0] < -ROUNDED * size:
        least = f"{np.linalg.eigvalsh(matrix)[0]:.3g}"
        raise OptionError(f"{name} has the negative eigenvalue {least}, but must be positive definite")
    return matrix


def _inverse(name: str, matrix: Array) -> Array:
    """The inverse of a covariance, scaled to a diagonal of ones first."""
    deviations = np.sqrt(np.diagonal(matrix))
    try:
        if not (deviations > 0).all():
            raise np.linalg.LinAlgError
        lower = np.linalg.cholesky(matrix / np.outer(deviations, deviations))
        # rounding would make the inverse indefinite
        if (np.diagonal(lower) < LEAST_PIVOT).any():
            raise np.linalg.LinAlgError
        root = np.linalg.inv(lower) / deviations
    except np.linalg.LinAlgError:
        advice = "leave covariances out (map_use='fixed') if landmarks are exact"
        raise OptionError(f"{name} is singular, so that it has no inverse; {advice}") from None
    return root.T @ root
