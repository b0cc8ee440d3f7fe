"""The verb ``simulate``: every option and every fault of the simulator on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .options import (
    BearingStd,
    Epsilon,
    JsonFile,
    Nn,
    No,
    On,
    Oo,
    OrientationStd,
    RangeRate,
    RangeStd,
    Seed,
    SensorOffset,
    SigmaOmega,
    SigmaV,
    plain,
)
from .parsing import check_faults, check_finite, numbers, places, points
from .support import Output, given, models, quoted, sentences

DRIVE, WORLD, CAMERA = "Drive", "World", "Camera"
WHEELS, EYES = "Faults of the wheels", "Faults of the camera"


def _option(text: str, panel: str, default: str, **more: Any) -> Any:
    return typer.Option(help=plain(text), rich_help_panel=panel, show_default=default, **more)


def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write (.npz keeps everything).")],
    world: Annotated[str, typer.Option(help="Named world to start from: book or garden; other options change it.",
                                       rich_help_panel=WORLD)] = "book",
    seed: Seed = 0,
    clean: Annotated[bool, typer.Option("--clean", help="No faults; noise exactly as the models have it.")] = False,
    format: Annotated[str | None, typer.Option(help="npz or lnpr.", show_default="by the suffix of OUT")] = None,
    truth: Annotated[bool, typer.Option(help="Keep the true poses and landmarks (lnpr cannot).")] = True,
    steps: Annotated[int | None, _option("Number of motions.", DRIVE, "62")] = None,
    dt: Annotated[float | None, _option("Duration of each motion [s].", DRIVE, "3")] = None,
    speed: Annotated[float | None, _option("nu, at most [m/s].", DRIVE, "0.2")] = None,
    turn_rate: Annotated[float | None, _option("omega, at most with way points [rad/s].", DRIVE, "π/36")] = None,
    way_points: Annotated[str | None, _option("Drive through 'x,y x,y ...' in turn [m].", DRIVE, "a circle")] = None,
    start: Annotated[str | None, _option("First pose, 'x,y,theta' [m, m, rad].", DRIVE, "0,-3,0")] = None,
    landmarks: Annotated[str | None, _option("Their number, or 'x,y x,y ...' [m].", WORLD, "the book's 6")] = None,
    arena: Annotated[float | None, _option("Half the side of the square world [m].", WORLD, "what it takes")] = None,
    min_range: Annotated[float | None, _option("Nearest sighting [m].", CAMERA, "0.5")] = None,
    max_range: Annotated[float | None, _option("Farthest sighting [m].", CAMERA, "6")] = None,
    field_of_view: Annotated[float | None, _option("Opening angle [rad].", CAMERA, "2π/3")] = None,
    orientation: Annotated[bool, typer.Option(help="Sightings with psi, or without.", rich_help_panel=CAMERA)] = True,
    kicks_per_metre: Annotated[float | None, _option("Pebbles on the way.", WHEELS, "5")] = None,
    kick_std: Annotated[float | None, _option("Turn by each pebble [rad].", WHEELS, "π/60")] = None,
    velocity_bias_std: Annotated[float | None, _option("Constant factor on nu and omega.", WHEELS, "0.1")] = None,
    stuck_interval: Annotated[float | None, _option("Mean time until stuck [s].", WHEELS, "inf")] = None,
    stuck_duration: Annotated[float | None, _option("Mean time stuck [s].", WHEELS, "3")] = None,
    kidnap_interval: Annotated[float | None, _option("Mean time between kidnappings [s].", WHEELS, "inf")] = None,
    range_noise_rate: Annotated[float | None, _option("Noise of the range, per metre of it.", EYES, "0.1")] = None,
    bearing_noise: Annotated[float | None, _option("Noise of the bearing [rad].", EYES, "π/90")] = None,
    orientation_noise: Annotated[float | None, _option("Noise of psi [rad].", EYES, "π/90")] = None,
    range_bias_rate_std: Annotated[float | None, _option("Constant bias of the range, per metre.", EYES, "0.1")] = None,
    bearing_bias_std: Annotated[float | None, _option("Constant bias of the bearing [rad].", EYES, "π/90")] = None,
    orientation_bias_std: Annotated[float | None, _option("Constant bias of psi [rad].", EYES, "π/90")] = None,
    phantom: Annotated[float | None, _option("Probability of a false place.", EYES, "0")] = None,
    oversight: Annotated[float | None, _option("Probability of not seeing.", EYES, "0.1")] = None,
    occlusion: Annotated[float | None, _option("Probability of a range too long.", EYES, "0")] = None,
    nn: Nn = None, no: No = None, on: On = None, oo: Oo = None,
    sigma_v: SigmaV = None, sigma_omega: SigmaOmega = None, epsilon: Epsilon = None,
    range_rate: RangeRate = None, range_std: RangeStd = None, bearing_std: BearingStd = None,
    orientation_std: OrientationStd = None, sensor_offset: SensorOffset = None,
    json: JsonFile = None,
) -> None:  # fmt: skip
    """Write a simulated log with its truth.

    The robot has the book's faults, each of which can be changed; with --clean only the noise of the models.
    """
    with sentences():
        import graphslam
        from graphslam.checks import check_choice

        from ..comparison import describe
        from ..results import check_can_write

        output = Output(json)
        check_can_write(out)
        check_choice("--world", world, tuple(graphslam.WORLDS))
        wheels = given({
            "kicks_per_metre": kicks_per_metre, "kick_std": kick_std, "velocity_bias_std": velocity_bias_std,
            "stuck_interval": stuck_interval, "stuck_duration": stuck_duration, "kidnap_interval": kidnap_interval,
        })  # fmt: skip
        camera = given({
            "range_noise_rate": range_noise_rate, "bearing_noise": bearing_noise,
            "orientation_noise": orientation_noise, "range_bias_rate_std": range_bias_rate_std,
            "bearing_bias_std": bearing_bias_std, "orientation_bias_std": orientation_bias_std,
            "phantom": phantom, "oversight": oversight, "occlusion": occlusion,
        })  # fmt: skip
        check_faults(wheels | camera)
        noise: dict[str, Any] = {
            "nn": nn, "no": no, "on": on, "oo": oo, "sigma_v": sigma_v, "sigma_omega": sigma_omega, "epsilon": epsilon,
            "range_rate": range_rate, "range_std": range_std, "bearing_std": bearing_std,
            "orientation_std": orientation_std,
        }  # fmt: skip
        if not clean and (given(noise) or sensor_offset is not None):
            raise graphslam.OptionError(
                "the noise models drive only --clean simulations; add it, or set faults instead"
            )
        motion, sensor = models(None, sensor_offset=sensor_offset, **noise)
        changes = given({
            "steps": steps, "dt": dt, "speed": speed, "turn_rate": turn_rate, "arena": arena, "min_range": min_range,
            "max_range": max_range, "field_of_view": field_of_view,
            "way_points": None if way_points is None else points("--way-points", way_points),
            "start": None if start is None else numbers("--start", start, count=3),
            "landmarks": None if landmarks is None else places("--landmarks", landmarks),
            "motion_faults": graphslam.MotionFaults(**wheels) if wheels else None,
            "sensor_faults": graphslam.SensorFaults(**camera) if camera else None,
        })  # fmt: skip
        check_finite(changes)
        log = graphslam.simulate(
            graphslam.WORLDS[world], **changes, orientation=orientation, clean=clean, motion=motion, sensor=sensor,
            seed=seed, name=out.stem,
        )  # fmt: skip
        graphslam.save(log if truth else log.replace(true_poses=None, true_landmarks=None), out, format=format)
        seen = len(log.landmark_ids)
        output.say(f"Wrote {out}: {log.num_poses} poses, {len(log.steps)} sightings of {seen} landmarks.")
        output.hint(f"Next: slam-compare run {quoted(out)}")
        output.json({"file": str(out), "log": describe(log, out)})
