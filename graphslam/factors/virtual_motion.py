"""Two sightings of one landmark tie two poses together."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..engine import engine
from ..errors import OptionError
from ..linear.precision import model_of
from ..models import SensorModel
from .arguments import PoseLike, frozen_at, in_robot_frame, in_world_frame, noise_sighting, sighted_covariance, sighting
from .base import POSE, Coordinates, Factor, KernelLike, Linearized, noise_model


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
        at: the two poses, each (3,) or a `gtsam.Pose2`, at which state-dependent information is evaluated.
        scale: factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.
        noise_at: the two sightings at which Q and L are evaluated; default: the measured ones.

    Raises:
        OptionError: an argument has an impossible value, or ``at`` is missing where the information depends on the poses.

    Source: the lectures, slides 9.1 to 9.2.
    """

    def __init__(
        self,
        key_1: int,
        key_2: int,
        z_1: ArrayLike,
        z_2: ArrayLike,
        sensor: SensorModel | None = None,
        *,
        frame: str = "body",
        at: tuple[PoseLike, PoseLike] | None = None,
        scale: float = 1.0,
        kernel: KernelLike = None,
        noise_at: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> None:
        sensor, body = model_of(SensorModel, sensor), not in_world_frame(frame)
        z_1, z_2 = sighting("z_1", z_1), sighting("z_2", z_2)
        if len(z_1) != len(z_2):
            raise OptionError("z_1 and z_2 must both have psi, or both lack it")
        oriented = len(z_1) == 3
        _, phi1, psi1 = (*z_1.tolist(), 0.0)[:3]
        frozen = frozen_at(at, needed=not (body and oriented), rows=2, frame=frame)
        at_1, at_2 = z_1.tolist(), z_2.tolist()
        if noise_at is not None:
            if not hasattr(noise_at, "__len__") or len(noise_at) != 2:
                raise OptionError("noise_at must be two sightings, as z_1 and z_2 are")
            at_1, at_2 = (noise_sighting(seen, z).tolist() for seen, z in zip(noise_at, (z_1, z_2)))
        # poses that see the landmark in the axes of the first sighting, if the information does not depend on the poses
        headings = [at_1[-1] - at_1[1] - psi1, at_2[-1] - at_2[1] - psi1] if frozen is None else frozen[:, 2].tolist()
        covariance = sighted_covariance(headings[0], at_1, sensor) + sighted_covariance(headings[1], at_2, sensor)
        # in the body frame e is in axes that stand at this angle to the heading of the first pose
        ahead = phi1 if oriented else -headings[0]
        pair = engine.LandmarkPair(z_1.tolist(), z_2.tolist(), sensor.offset, ahead, body)

        def residual(a: Coordinates, b: Coordinates) -> Linearized:
            # derivatives by GTSAM's perturbations, each pose's in its own axes
            e_and_columns = pair.linearized(a, b)
            return e_and_columns[0], (e_and_columns[1:4].T, e_and_columns[4:].T)

        options = {"frame": frame, "at": frozen, "scale": scale, "kernel": kernel}
        options["noise_at"] = None if noise_at is None else np.array([at_1, at_2])
        arguments = {"z_1": z_1, "z_2": z_2, "sensor": sensor} | options
        super().__init__([key_1, key_2], [POSE, POSE], residual, arguments, covariance=covariance, in_own_axes=True)

    def to_between(self) -> gtsam.BetweenFactorPose2:
        """GTSAM's own factor of the same two sightings, with the speed of C++: the relative pose z_12 = T_1 T_2^-1.

        T = (l cos phi, l sin phi, phi - psi), plus the offset of the sensor, is the landmark as a pose seen from the
        robot. The noise that the landmark has in its own axes, C = L(l_1, psi_1) Q_1 L' + L(l_2, psi_2) Q_2 L', becomes
        Ad(T_2) C Ad(T_2)' by the adjoint. Value and information agree with this factor where e = 0; GTSAM measures the
        error through the logarithm of SE(2), so away from there they differ (docs/factors.md has figures).

        Raises:
            OptionError: without psi two sightings measure no relative pose.
        """
        arguments = self.description.arguments
        z_1, z_2, sensor = arguments["z_1"], arguments["z_2"], arguments["sensor"]
        if len(z_1) != 3:
            raise OptionError("without psi two sightings of a landmark measure no relative pose")
        landmark_1, landmark_2 = (gtsam.Pose2(*in_robot_frame(z, sensor), z[1] - z[2]) for z in (z_1, z_2))
        # a pose whose theta + phi is psi sees the landmark in the landmark's own axes
        noisy = (z_1, z_2) if arguments["noise_at"] is None else arguments["noise_at"]
        covariance = sum(sighted_covariance(z[2] - z[1], z, sensor) for z in noisy)
        adjoint = landmark_2.AdjointMap()
        covariance = adjoint @ covariance @ adjoint.T
        noise = noise_model(arguments, covariance=(covariance + covariance.T) / 2)
        key_1, key_2 = self.keys()
        return gtsam.BetweenFactorPose2(key_1, key_2, landmark_1.compose(landmark_2.inverse()), noise)
