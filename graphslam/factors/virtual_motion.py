"""Two sightings of one landmark tie two poses together."""

from __future__ import annotations

from math import cos, sin

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_choice, check_positive
from ..edges.robust import Kernel
from ..errors import OptionError
from ..models import SensorModel
from .layer import POSE, Coordinates, Factor, robust_noise, seen_from_robot, sensor_of, sighting, vector, wrapped


class VirtualMotionFactor(Factor):
    """Two sightings of one landmark, from the poses at two keys: e = h^-1(x_2, z_2) - h^-1(x_1, z_1).

    Omega^-1 = R_1 Q_1 R_1' + R_2 Q_2 R_2'. With ``frame="body"`` and psi the residual is turned into the first
    sighting's axes, R(theta_1 + phi_1)' e, where Omega^-1 = L(l_1, 0) Q_1 L' + L(l_2, psi_2 - psi_1) Q_2 L' depends on
    the sightings alone. In all other cases the information depends on the poses and is frozen at the poses ``at``:
    ``frame="world"`` keeps e in the world's axes; ``frame="body"`` without psi turns e, and the frozen information,
    with the first pose.

    Args:
        key_1, key_2: of two `gtsam.Pose2`.
        z_1, z_2: sightings (l, phi, psi) or (l, phi) [m, rad, rad].
        sensor: gives Q; default: the book's.
        frame: "body" or "world".
        at: the two poses ((3,), (3,)) at which state-dependent information is evaluated.
        weight: factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: a value is not what it must be, or ``at`` is missing where the information depends on the poses.

    Source: the lectures, slides 9.1 to 9.2.
    """

    def __init__(
        self,
        key_1: int,
        key_2: int,
        z_1: ArrayLike,
        z_2: ArrayLike,
        sensor: SensorModel | None = None,
        frame: str = "body",
        *,
        at: tuple[ArrayLike, ArrayLike] | None = None,
        weight: float = 1.0,
        kernel: Kernel | str | None = None,
    ) -> None:
        check_choice("frame", frame, ("world", "body"))
        check_positive(weight=weight)
        sensor = sensor_of(sensor)
        first, second = sighting("z_1", z_1), sighting("z_2", z_2)
        if len(first) != len(second):
            raise OptionError("z_1 and z_2 must both have psi, or both lack it")
        oriented = len(first) == 3
        (_, phi1, psi1), (_, phi2, psi2) = ((*z, 0.0)[:3] for z in (first.tolist(), second.tolist()))
        if frame == "body" and oriented:
            axes_1, axes_2 = np.array([0.0, 0.0, -phi1]), np.array([0.0, 0.0, psi2 - psi1 - phi2])
            covariance = sensor.landmark_covariance(axes_1, first) + sensor.landmark_covariance(axes_2, second)
        elif at is None:
            raise OptionError(
                f"with frame={frame!r} and {len(first)}-D sightings the information depends on the poses; "
                "give them as 'at'"
            )
        else:
            if not hasattr(at, "__len__") or len(at) != 2:
                raise OptionError(f"at must be two poses, not {at!r}")
            x1, x2 = vector("at[0]", at[0], (3,)), vector("at[1]", at[1], (3,))
            covariance = sensor.landmark_covariance(x1, first) + sensor.landmark_covariance(x2, second)
        # the landmark in the frame of the robot, by each sighting
        (px, py), (qx, qy) = (seen_from_robot(z, sensor) for z in (first, second))
        body, frozen = frame == "body", 0.0 if oriented or frame == "world" else float(x1[2])

        def residual(a: Coordinates, b: Coordinates) -> tuple[list[float], tuple[list[list[float]], ...]]:
            ca, sa, cb, sb = cos(a[2]), sin(a[2]), cos(b[2]), sin(b[2])
            # from each pose to the landmark; turning the pose moves that end by a quarter turn of it
            ux, uy, vx, vy = ca * px - sa * py, sa * px + ca * py, cb * qx - sb * qy, sb * qx + cb * qy
            ex, ey = b[0] + vx - a[0] - ux, b[1] + vy - a[1] - uy
            ax, ay, bx, by = uy, -ux, -vy, vx
            e, by_a, by_b = [ex, ey], [[-1.0, 0.0, ax], [0.0, -1.0, ay]], [[1.0, 0.0, bx], [0.0, 1.0, by]]
            if body:
                # the axes turn with pose a: towards the landmark, or as pose a has turned since the freezing
                turn = a[2] + phi1 if oriented else a[2] - frozen
                c, s = cos(turn), sin(turn)
                e = [c * ex + s * ey, -s * ex + c * ey]
                by_a = [[-c, -s, c * ax + s * ay + e[1]], [s, -c, -s * ax + c * ay - e[0]]]
                by_b = [[c, s, c * bx + s * by], [-s, c, -s * bx + c * by]]
            if oriented:
                e.append(wrapped(b[2] + phi2 - psi2 - a[2] - phi1 + psi1))
                by_a.append([0.0, 0.0, -1.0])
                by_b.append([0.0, 0.0, 1.0])
            return e, (by_a, by_b)

        noise = gtsam.noiseModel.Gaussian.Covariance(covariance / weight)
        # the poses matter only where the information was frozen at them
        frozen_at = None if (body and oriented) or at is None else (x1, x2)
        arguments = {"z_1": first, "z_2": second, "sensor": sensor, "frame": frame, "at": frozen_at, "weight": weight}
        super().__init__([key_1, key_2], [POSE, POSE], noise, residual, arguments, kernel)

    def to_between(self) -> gtsam.BetweenFactorPose2:
        """GTSAM's own factor of the same two sightings: the relative pose z_12 = T_1 T_2^-1 at C++ speed.

        T = (l cos phi, l sin phi, phi - psi), plus the offset of the sensor, is the landmark as a pose seen from the
        robot. The noise that the landmark has in its own axes, C = L(l_1, psi_1) Q_1 L' + L(l_2, psi_2) Q_2 L', becomes
        Ad(T_2) C Ad(T_2)' by the adjoint. Value and information agree with this factor where e = 0; GTSAM measures the
        error through the logarithm of SE(2), so away from there they differ (docs/factors.md has figures).

        Raises:
            OptionError: without psi two sightings measure no relative pose.
        """
        told = self.description.arguments
        first, second = told["z_1"], told["z_2"]
        if len(first) != 3:
            raise OptionError("without psi two sightings of a landmark measure no relative pose")
        sensor = told["sensor"]
        seen = [gtsam.Pose2(*seen_from_robot(z, sensor), z[1] - z[2]) for z in (first, second)]
        # a pose whose theta + phi is psi sees the landmark in the landmark's own axes
        own = [np.array([0.0, 0.0, z[2] - z[1]]) for z in (first, second)]
        covariance = sensor.landmark_covariance(own[0], first) + sensor.landmark_covariance(own[1], second)
        adjoint = seen[1].AdjointMap()
        carried = adjoint @ covariance @ adjoint.T / told["weight"]
        noise = robust_noise(gtsam.noiseModel.Gaussian.Covariance((carried + carried.T) / 2), told.get("kernel"))
        key_1, key_2 = self.keys()
        return gtsam.BetweenFactorPose2(key_1, key_2, seen[0].compose(seen[1].inverse()), noise)
