"""A factor of one's own, from a residual function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_choice
from ..errors import OptionError, quoted
from ..se2 import Array
from .arguments import positive_definite
from .base import KINDS, POSE, Coordinates, Factor, KernelLike, Linearized, listed_keys

#: the step of numeric derivatives [m, rad]
STEP = 1e-6


class ResidualFactor(Factor):
    """Any residual between poses and points, with cost e' Omega e, evaluated as safely as the other factor types.

    Args:
        keys: one for each argument of the residual.
        residual: called with one array per key, (x, y, theta) of a `gtsam.Pose2` or (x, y) of a `gtsam.Point2`. Returns
            e (d,), or (e, [de/d(x, y, theta) (d, 3) or de/d(x, y) (d, 2) for each key]); derivatives are by plain world
            coordinates, and turned into GTSAM's here. Without them central differences are taken, for which e must not
            jump (wrap angles so that the jump is far from the values you expect).
        information: Omega (d, d).
        kinds: "pose" or "point" for each key; default: poses.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value.

    A residual that raises, or returns something of another shape or not finite, becomes a `FactorError` that names the
    factor and its keys. The residual may close over plain numbers but not over the factor, which GTSAM would never free.
    """

    keys_in_list = True

    def __init__(
        self,
        keys: Sequence[int],
        residual: Callable[..., Any],
        information: ArrayLike,
        *,
        kinds: Sequence[str] | None = None,
        kernel: KernelLike = None,
    ) -> None:
        keys = listed_keys("ResidualFactor", keys)
        if not (kinds is None or isinstance(kinds, (list, tuple))):
            raise OptionError(f"kinds must be a list of {' and '.join(KINDS)}, not {quoted(kinds)}")
        kinds = [POSE] * len(keys) if kinds is None else list(kinds)
        for kind in kinds:
            check_choice("kinds", kind, tuple(KINDS))
        if len(kinds) != len(keys) or not keys:
            raise OptionError(f"ResidualFactor needs one kind per key, not {len(kinds)} for {len(keys)} keys")
        if not callable(residual):
            raise OptionError(f"residual must be a function, not {quoted(residual)}")
        try:
            shape = np.shape(np.asarray(information, dtype=float))
            rows = shape[0] if len(shape) == 2 else 0
        except Exception:  # objects that NumPy asks for numbers may raise anything
            rows = 0
        omega = positive_definite(information, rows)

        def evaluated(*at: Coordinates) -> Linearized:
            values = [np.array(value, dtype=float) for value in at]
            answer = residual(*values)
            return answer if isinstance(answer, tuple) else (answer, _Differences(residual, values))

        arguments = {"residual": residual, "information": omega, "kinds": tuple(kinds), "kernel": kernel}
        super().__init__(keys, kinds, evaluated, arguments, information=omega)


class _Differences(Sequence[Array]):
    """The Jacobians of a residual by central differences, computed when they are read."""

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
