"""Huang's simulated range-bearing logs: a folder of MATLAB files, with ground truth.

Source: Shoudong Huang (University of Technology Sydney), the simulated 2-D point-feature data sets with 535 and 8,240
steps, used in Huang, Wang and Dissanayake, *Sparse local submap joining filter for building large-scale maps*, IEEE
T-RO 24(5), 2008; published on OpenSLAM (https://openslam-org.github.io, 2D-I-SLSJF). Terms: none stated.

Files::

    store_speed.mat, store_turnrate.mat    (1, T) measured speed [m/s] and turn rate [rad/s] of each 0.3 s step
    sensor_data.mat                        (M, 7) step k from 1, beacon, range [m], bearing [rad], 0, 0, 0
    parameters.txt                         the noise: sigv, sigomega, sigr, sigtheta
    store_robotTrue.mat                    (3, T+1) true poses; optional here
    store_beaconsTrue.mat                  (B, 3) id, x, y [m]; optional here

Peculiarities: line k of the sensor data is seen from pose k-1, counted from 0. Bearings are not wrapped. The robot drives
over beacons, and noise takes the range of a few sightings below zero: those are left out and counted. parameters.txt
says "variance" but sigv and the others are standard deviations (the files' own noise shows it). The robot turns first
and then drives straight, x' = x + v dt cos(phi + omega dt): each step becomes two controls, turn and drive, of half the
step each at twice the rate. The beacons of the large set are stored as unsigned 16-bit numbers, and its turn rates are
noisier than its parameters.txt says: 2.85 degrees/s, not 2.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from ..errors import FormatError, OptionError
from ..files import check_file
from ..log import Log
from ..log.rows import ReadOptions, sound_sightings
from ..models import MotionModel, SensorModel
from ..se2 import Array
from .base import NO_SIGHTING, Format, errors_name, member, optional_member
from .mat import Shape, read_mat

#: [s], as parameters.txt says
STEP = 0.3

#: a small part of the pose covariance, without which a step of two noisy numbers would be singular
EPSILON = 1e-8

#: a decimal number
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_HOLDS = {
    "store_speed": "the measured speed of each step",
    "store_turnrate": "the measured turn rate of each step",
    "sensor_data": "the ranges and bearings that the robot measured",
}


def _recognises(path: Path, _: bytes) -> bool:
    return path.is_dir() and any((path / f"{stem}.mat").exists() for stem in _HOLDS)


def _read(folder: Path, options: ReadOptions) -> Log:
    if not folder.is_dir():
        raise FormatError(folder, None, "one of Huang's logs is a folder (of sensor_data.mat and so on), not a file")

    def variable(stem: str, shape: Shape) -> Array:
        return read_mat(member(folder, f"{stem}.mat", _HOLDS[stem]), {stem: shape})[stem]

    def optional(stem: str, shape: Shape, holds: str) -> Array | None:
        path = optional_member(folder, f"{stem}.mat", holds, notes)
        return None if path is None else read_mat(path, {stem: shape})[stem]

    notes: list[str] = []
    (speed,) = variable("store_speed", (1, "steps"))
    (turn,) = variable("store_turnrate", (1, len(speed)))
    path, seen = folder / "sensor_data.mat", variable("sensor_data", ("sightings", 7))
    if len(seen) == 0:
        raise FormatError(path, None, NO_SIGHTING)
    seen = seen[np.argsort(seen[:, 0], kind="stable")]
    # beyond 2^53 floating-point numbers leave out whole numbers
    whole = not np.any((seen[:, :2] % 1 != 0) | (np.abs(seen[:, :2]) > 2**53))
    if seen[0, 0] < 1 or seen[-1, 0] > len(speed) + 1 or not whole:
        raise FormatError(path, None, f"steps and beacons must be whole numbers, and steps 1 to {len(speed) + 1}")
    kept, about = sound_sightings(seen[:, 2:4], lambda _, text: FormatError(path, None, text), strict=options.strict)
    notes, seen = [*notes, *about], seen[kept]
    truth = optional("store_robotTrue", (3, len(speed) + 1), "the true poses")
    beacons = optional("store_beaconsTrue", ("beacons", 3), "the true landmarks")
    parameters = optional_member(folder, "parameters.txt", "the noise", notes)
    motion, sensor = _noise(parameters) if parameters is not None else (None, None)
    if parameters is not None and motion is None:
        notes.append("parameters.txt does not give the noise: read without")
    controls = np.zeros((len(speed), 2, 2))
    controls[:, 0, 1], controls[:, 1, 0] = 2 * turn, 2 * speed
    with errors_name(path):
        return Log(
            dt=np.full(2 * len(speed), STEP / 2),
            controls=controls.reshape(-1, 2),
            control_starts=2 * np.arange(len(speed) + 1),
            steps=seen[:, 0].astype(np.int64) - 1,
            landmarks=seen[:, 1].astype(np.int64),
            sightings=seen[:, 2:4],
            true_poses=None if truth is None else truth.T,
            true_landmarks=None if beacons is None else {int(row[0]): row[1:] for row in beacons},
            motion=motion,
            sensor=sensor,
            name=folder.resolve().name,
            notes=tuple(notes),
        )


def _noise(path: Path) -> tuple[MotionModel | None, SensorModel | None]:
    """The models that parameters.txt gives, from lines like ``sigomega = (4*pi/180); --- ...``."""
    check_file(path)
    text = path.read_text(encoding="utf-8", errors="replace")
    sigma = {}
    for name in ("sigv", "sigomega", "sigr", "sigtheta"):
        match = re.search(rf"^\s*{name}\s*=\s*\(?\s*({_NUMBER})(?![\w.])\s*(\*\s*pi\s*/\s*180)?", text, re.MULTILINE)
        if match is None:
            return None, None
        sigma[name] = float(match[1]) * (math.pi / 180 if match[2] else 1.0)
    # two controls of half a step each, with independent errors, have together the published error of one whole step
    twice = math.sqrt(2)
    try:
        motion = MotionModel.constant(twice * sigma["sigv"], twice * sigma["sigomega"], epsilon=EPSILON)
        return motion, SensorModel.constant(sigma["sigr"], sigma["sigtheta"])
    except OptionError as error:
        raise FormatError(path, None, str(error)) from None


FORMAT = Format("huang", _recognises, _read)
