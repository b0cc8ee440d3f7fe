"""A factor of one's own, from a residual function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_choice
from ..edges.robust import Kernel
from ..errors import OptionError
from ..se2 import Array
from .layer import KINDS, POSE, Coordinates, Factor, positive_definite

#: the step of numeric derivatives [m, rad]
STEP = 1e-6


class ResidualFactor(Factor):
    """Any residual between poses and points, with cost e' Omega e, on the layer that makes our own factors safe.

    Args:
        keys: one for each argument of the residual.
        residual: called with one array per key, (x, y, theta) of a `gtsam.Pose2` or (x, y) of a `gtsam.Point2`. Returns
            e (d,), or (e, [de/d(x, y, theta) (d, 3) or de/d(x, y) (d, 2) for each key]); derivatives are by plain world
            coordinates, and turned into GTSAM's here. Without them they are taken by central differences, for which e
            must not jump (wrap angles around the value you expect, not at it).
        information: Omega (d, d).
        kinds: "pose" or "point" for each key; default: poses.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: a value is not what it must be.

    A residual that raises, or returns something of another shape or not finite, becomes a `FactorError` that names the
    factor and its keys. Close over plain numbers, not over the factor: GTSAM would never let it go.
    """

    def __init__(
        self,
        keys: Sequence[int],
        residual: Callable[..., Any],
        information: ArrayLike,
        kinds: Sequence[str] | None = None,
        *,
        kernel: Kernel | str | None = None,
    ) -> None:
        kinds = [POSE] * len(keys) if kinds is None else list(kinds)
        for kind in kinds:
            check_choice("kinds", kind, tuple(KINDS))
        if len(kinds) != len(keys) or not keys:
            raise OptionError(f"ResidualFactor needs one kind per key, not {len(kinds)} for {len(keys)} keys")
        if not callable(residual):
            raise OptionError(f"residual must be a function, not {residual!r}")
        if np.ndim(information) != 2:
            raise OptionError("information must be a symmetric positive definite d x d matrix")
        omega = positive_definite(information, len(np.asarray(information)))

        def evaluated(*at: Coordinates) -> tuple[ArrayLike, Sequence[ArrayLike]]:
            values = [np.array(value, dtype=float) for value in at]
            answer = residual(*values)
            return answer if isinstance(answer, tuple) else (answer, _Differences(residual, values))

        noise = gtsam.noiseModel.Gaussian.Information(omega)
        arguments = {"residual": residual, "information": omega, "kinds": tuple(kinds)}
        super().__init__(keys, kinds, noise, evaluated, arguments, kernel)


class _Differences(Sequence[Array]):
    """The Jacobians of a residual by central differences, taken only when asked for."""

    def __init__(self, residual: Callable[..., ArrayLike], values: list[Array]) -> None:
        self._residual, self._values = residual, values

    def __len__(self) -> int:
        return len(self._values)

    def __getitem__(self, k: Any) -> Any:
        columns = []
        for step in STEP * np.eye(len(self._values[k])):
            ahead, behind = (
                np.asarray(self._residual(*self._values[:k], self._values[k] + way * step, *self._values[k + 1 :]))
                for way in (1, -1)
            )
            columns.append((ahead - behind) / (2 * STEP))
        return np.stack(columns, axis=1)
