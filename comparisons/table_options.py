"""The options of verbs that read tables or bags of one's own: import and evaluate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from graphslam.checks import option
from graphslam.tables.options import TableOptions

from .option import OUTPUT, Options


@dataclass(frozen=True, kw_only=True)
class ImportOptions(Options):
    """Options of `importing.import_log`: the tables or topics of a drive, and how they are read."""

    panel = "Tables and topics"
    components = {"tables": (TableOptions, "Units, clocks, columns and axes")}
    odometry: str | None = option(
        None, "Table or topic of the odometry.", metavar="FILE|TOPIC", default_text="found by name and type"
    )
    sightings: str | None = option(None, "Table or topic of the sightings.", metavar="FILE|TOPIC")
    truth: str | None = option(None, "Table or topic of the true poses.", metavar="FILE|TOPIC")
    map: str | None = option(None, "Table of the true landmarks.", metavar="FILE")
    relations: str | None = option(None, "Table of measured relations between two poses.", metavar="FILE")
    positions: str | None = option(None, "Table of measured absolute positions, such as GPS.", metavar="FILE")
    recipe: Path | None = option(
        None, "TOML file with these options, files, topics and columns; see docs/own_robot.md.", metavar="FILE",
        default_text="import.toml in the folder",
    )  # fmt: skip
    keep_every: float | None = option(
        None, "Also keep a pose at least once in this time, even where nothing was seen.", unit="s", positive=True,
        default_text="poses only where something was seen", panel=OUTPUT,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class EvaluationOptions(Options):
    """How `evaluation.evaluate` compares estimates with the ground truth.

    In the options of tables, truth=... holds for the ground truth, estimates=... for the estimates, and a value without a
    table for all trajectories.
    """

    components = {"tables": (TableOptions, "Tables of trajectories")}
    hidden = ("axes", "centre", "bearings", "sensor_offset", "truth_offset", "sensor_yaw")
    true_map: Path | None = option(
        None, "The true map (.csv, .npz, .yaml, .geojson).", metavar="FILE", default_text="that of a log"
    )
    maps: tuple[Path, ...] | None = option(
        None, "The maps of the estimates, in their order; - for none.", metavar="FILE,..."
    )
    match: str = option(
        "id", "How the error of a map finds pairs of landmarks: by their ids, or by place within the cutoff.",
        choices=("id", "place"),
    )  # fmt: skip
    cutoff: float = option(
        1.0, "A landmark farther than this from every true one is false; of GOSPA.", unit="m", positive=True
    )
    longest_gap: float = option(
        1.0, "The truth is interpolated across gaps that are not longer than this.", unit="s", positive=True
    )
