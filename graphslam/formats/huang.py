"""Huang's simulated range-bearing logs: a folder of MATLAB files, with truth.

Source: Shoudong Huang (University of Technology Sydney), the simulated 2-D point-feature data sets with 535 and 8,240
steps, used in Huang, Wang and Dissanayake, *Sparse local submap joining filter for building large-scale maps*, IEEE
T-RO 24(5), 2008; published on OpenSLAM (https://openslam-org.github.io, 2D-I-SLSJF). Terms: none stated.

Files::

    store_speed.mat, store_turnrate.mat    (1, T) measured speed [m/s] and turn rate [rad/s] of each 0.3 s step
    sensor_data.mat                        (M, 7) step k from 1, beacon, range [m], bearing [rad], 0, 0, 0
    parameters.txt                         the noise: sigv, sigomega, sigr, sigtheta
    store_robotTrue.mat                    (3, T+1) true poses; optional here
    store_beaconsTrue.mat                  (B, 3) id, x, y [m]; optional here

Oddities: line k of the sensor data is seen from pose k-1, counted from 0. Bearings are not wrapped. The robot drives
over beacons, and noise takes the range of a few sightings below zero: those are left out and counted. parameters.txt
says "variance" but sigv and the others are standard deviations (the files' own noise shows it). The robot turns first
and then drives straight, x' = x + v dt cos(phi + omega dt): each step becomes two controls, turn and way, of half the
step each at twice the rate. The beacons of the large set are stored as unsigned 16-bit numbers, and its turn rates are
noisier than its parameters.txt says: 2.85 degrees/s, not 2.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from ..errors import FormatError, LogError
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array, wrap
from .base import Format
from .mat import numbers, read_mat

#: [s], as parameters.txt says
STEP = 0.3

#: the part of the pose covariance without which a step of two noisy numbers would be singular; small against them
EPSILON = 1e-8

_HOLDS = {
    "store_speed.mat": "the measured speed of each step",
    "store_turnrate.mat": "the measured turn rate of each step",
    "sensor_data.mat": "the ranges and bearings that the robot saw",
}


def _recognises(path: Path, head: bytes) -> bool:  # noqa: ARG001
    return path.is_dir() and any((path / name).exists() for name in _HOLDS)


def _variable(folder: Path, stem: str, shape: tuple[int | None, ...]) -> Array:
    path = folder / f"{stem}.mat"
    if path.name in _HOLDS and not path.is_file():
        raise FormatError(path, None, f"this file of the data set is missing; it would hold {_HOLDS[path.name]}")
    return numbers(path, stem, read_mat(path, (stem,))[stem], shape)


def _read(folder: Path) -> Log:
    if not folder.is_dir():
        raise FormatError(folder, None, "one of Huang's logs is a folder (of sensor_data.mat and so on), not a file")
    speed, turn = (_variable(folder, stem, (1, None))[0] for stem in ("store_speed", "store_turnrate"))
    if len(speed) != len(turn):
        raise FormatError(
            folder / "store_turnrate.mat",
            None,
            f"{len(turn)} turn rates for the {len(speed)} speeds of store_speed.mat",
        )
    path = folder / "sensor_data.mat"
    seen = _variable(folder, "sensor_data", (None, 7))
    if len(seen) == 0:
        raise FormatError(path, None, "no sighting of any landmark: nothing to estimate from")
    seen = seen[np.argsort(seen[:, 0], kind="stable")]
    if seen[0, 0] < 1 or seen[-1, 0] > len(speed) + 1 or np.any(seen[:, :2] != np.round(seen[:, :2])):
        raise FormatError(path, None, f"steps and beacons must be whole numbers, and steps 1 to {len(speed) + 1}")
    notes, truth, beacons = [], None, None
    near = seen[:, 2] <= 0
    if near.any():
        notes.append(f"{near.sum()} of {len(seen)} sightings have a range not above zero: left out")
        seen = seen[~near]
        if len(seen) == 0:
            raise FormatError(path, None, "no sighting has a range above zero: nothing to estimate from")
    if (folder / "store_robotTrue.mat").is_file():
        truth = _variable(folder, "store_robotTrue", (3, len(speed) + 1)).T
    else:
        notes.append("store_robotTrue.mat, which would hold the true poses, is missing: read without")
    if (folder / "store_beaconsTrue.mat").is_file():
        rows = _variable(folder, "store_beaconsTrue", (None, 3))
        beacons = {int(row[0]): row[1:] for row in rows}
    else:
        notes.append("store_beaconsTrue.mat, which would hold the true landmarks, is missing: read without")
    motion, sensor = _noise(folder / "parameters.txt")
    if motion is None:
        notes.append("parameters.txt, which would hold the noise, is missing or says nothing of it: read without")
    controls = np.zeros((len(speed), 2, 2))
    controls[:, 0, 1], controls[:, 1, 0] = 2 * turn, 2 * speed
    sightings = seen[:, 2:4].copy()
    sightings[:, 1] = wrap(sightings[:, 1])
    dt, starts = np.full(2 * len(speed), STEP / 2), 2 * np.arange(len(speed) + 1)
    try:
        return Log(
            dt=dt,
            controls=controls.reshape(-1, 2),
            control_starts=starts,
            steps=seen[:, 0].astype(np.int64) - 1,
            landmarks=seen[:, 1].astype(np.int64),
            sightings=sightings,
            true_poses=truth,
            true_landmarks=beacons,
            motion=motion,
            sensor=sensor,
            name=folder.resolve().name,
            notes=tuple(notes),
        )
    except LogError as error:
        raise FormatError(path, None, str(error)) from None


def _noise(path: Path) -> tuple[MotionModel | None, SensorModel | None]:
    """The models that parameters.txt gives, from lines like ``sigomega = (4*pi/180); --- ...``."""
    if not path.is_file():
        return None, None
    text = path.read_text(encoding="utf-8", errors="replace")
    sigma = {}
    for name in ("sigv", "sigomega", "sigr", "sigtheta"):
        found = re.search(rf"^\s*{name}\s*=\s*\(?\s*([\d.eE+-]+)\s*(\*\s*pi\s*/\s*180)?", text, re.MULTILINE)
        if found is None:
            return None, None
        sigma[name] = float(found[1]) * (math.pi / 180 if found[2] else 1.0)
    # two controls of half a step each, with independent errors, add up to the published error of one whole step
    twice = math.sqrt(2)
    return (
        MotionModel.constant(twice * sigma["sigv"], twice * sigma["sigomega"], epsilon=EPSILON),
        SensorModel(range_rate=0.0, range_std=sigma["sigr"], bearing_std=sigma["sigtheta"]),
    )


FORMAT = Format("huang", (), _recognises, _read)
