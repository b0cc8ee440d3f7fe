"""The base of the models, and the types of their fields.

`document` fills a model from result objects whose attributes have the names of its fields.

The JSON of what is known of a log: reading, importing, simulating, showing, finding and calibrating it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
import numpy as np

from graphslam.metrics import METRICS

from ..saving import jsonable

if TYPE_CHECKING:
    from graphslam import Log

_MISSING = object()


class Document(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """The base of all models."""


def document(model: type[Document], *sources: object, **values: Any) -> dict[str, Any]:
    """The fields of a model as plain data for JSON, in their order.

    Args:
        model: names the fields.
        sources: objects; a field takes the attribute of its name from the first that has one.
        values: fields that are given here.

    Raises:
        AttributeError: no source has a field that is not given.
    """
    content = {}
    for field in msgspec.structs.fields(model):
        value = values.get(field.name, _MISSING)
        for source in sources:
            if value is _MISSING:
                value = getattr(source, field.name, _MISSING)
        if value is _MISSING:
            raise AttributeError(f"{model.__name__} needs a value for {field.name}")
        content[field.name] = value
    return jsonable(content)


def about(text: str) -> msgspec.Meta:
    """The description of a field."""
    return msgspec.Meta(description=text)


#: a model with a field for each metric, as `graphslam.metrics.Errors` declares them
ErrorsDocument: Any = msgspec.defstruct(
    "ErrorsDocument",
    [(n, Annotated[float | None, about(f"{m['help']} [{m['unit']}]")]) for n, m in METRICS.items()],
    bases=(Document,),
    kw_only=True,
)

Count = Annotated[int, msgspec.Meta(ge=0)]
Id = Annotated[str, msgspec.Meta(pattern="^-?[0-9]+$")]
Dimensions = Annotated[Literal[2, 3], about("columns of a sighting: 2 without, 3 with orientation psi")]
Pose = Annotated[
    list[float | None],
    msgspec.Meta(min_length=3, max_length=3, description="x [m], y [m], heading [rad]; null where unknown"),
]
Position = Annotated[
    list[float | None],
    msgspec.Meta(min_length=2, max_length=3, description="x, y [m] and, where the landmark has one, heading [rad]"),
]
Covariance = Annotated[
    list[list[float]],
    msgspec.Meta(min_length=2, max_length=3, description="n rows of n numbers, n as long as the mean"),
]
CostPerDof = Annotated[
    float | None,
    about("J per degree of freedom: about 1 where the noise models fit, more where they are too small or sightings are "
          "wrong, less where they are too large; null where nothing is minimised"),
]  # fmt: skip
Band = Annotated[list[float | None], msgspec.Meta(min_length=2, max_length=2, description="lower and upper end")]
Quartiles = Annotated[
    list[float], msgspec.Meta(min_length=3, max_length=3, description="25 %, 50 % and 75 % over the seeds")
]


class LogDocument(Document):
    """The log that the estimators worked on."""

    name: Annotated[str, about("name of the log")]
    file: Annotated[str | None, about("file or folder it was read from")]
    poses: Annotated[Count, about("number of poses, T + 1")]
    sightings: Annotated[Count, about("number of sightings")]
    landmarks: Annotated[Count, about("number of landmarks seen")]
    dimensions: Dimensions
    classes: Annotated[dict[str, int] | None, about("number of sightings of each class; null without classes")]
    simulated: Annotated[bool, about("whether `simulate` made it; all others count as real data")]
    has_controls: Annotated[bool, about("whether there is odometry")]
    controls: Annotated[Count | None, about("number of controls")]
    poses_covered: Annotated[Count, about("number of poses whose ground truth is known")]
    true_poses: Annotated[list[Pose] | None, about("the true trajectory")]
    truth_offset: Annotated[
        list[float], about("the point of the robot that `true_poses` are of: ahead and to the left of its pose [m]")
    ]
    true_landmarks: Annotated[dict[Id, Position] | None, about("the true map, by id")]
    notes: Annotated[list[str], about("remarks of the reader")]


def describe(log: Log, source: Path | None = None) -> dict[str, Any]:
    """A log in a few numbers and with its ground truth, for JSON."""
    return document(
        LogDocument,
        log,
        file=source,
        poses=log.num_poses,
        sightings=len(log.steps),
        landmarks=len(log.landmark_ids),
        dimensions=log.sightings.shape[1],
        classes=None if log.classes is None else _counts(log.classes[log.classified]),
        has_controls=log.controls is not None,
        controls=None if log.controls is None else len(log.controls),
        poses_covered=int(np.count_nonzero(log.covered)),
    )


def _counts(classes: np.ndarray) -> dict[str, int]:
    names, counts = np.unique(classes, return_counts=True)
    return dict(zip(map(str, names.tolist()), counts.tolist()))


class SimulateDocument(Document):
    """`slam-compare simulate`."""

    file: Annotated[str, about("the file written")]
    log: LogDocument


class StreamDocument(Document):
    """A table or topic that was read."""

    kind: Annotated[Literal["odometry", "sightings", "truth"], about("what it holds")]
    source: Annotated[str, about("its file or topic")]
    rows: Annotated[Count, about("number of rows")]
    begin: Annotated[float, about("first time of its clock [s]")]
    end: Annotated[float, about("last time of its clock [s]")]
    rate: Annotated[float | None, about("different times per second")]
    columns: Annotated[list[str], about("which column was taken for what, with its unit")]


class TopicDocument(Document):
    """A topic of a bag."""

    name: Annotated[str, about("name of the topic")]
    type: Annotated[str, about("type of its messages")]
    count: Annotated[Count, about("number of messages")]
    could_be: Annotated[Literal["odometry", "sightings", "truth", ""], about("what it could be; empty: of no use")]
    chosen: Annotated[Literal["odometry", "sightings", "truth", ""], about("what it is read for; empty: it is not")]


class ImportDocument(Document):
    """`slam-compare import`."""

    source: Annotated[str | None, about("the folder or bag; null where each table was named")]
    topics: Annotated[list[TopicDocument], about("the topics of a bag")]
    streams: Annotated[list[StreamDocument], about("the tables or topics that were read")]
    log: Annotated[LogDocument | None, about("the log; null where the topics make none")]
    file: Annotated[str | None, about("the log that was written; null where none was")]
    reason: Annotated[str, about("why there is no log")]
    warnings: Annotated[list[str], about("what is probably wrong with the log, with the likely cause")]


class FindingDocument(Document):
    """Something in a log that is probably a mistake."""

    check: Annotated[str, about("short name of the check")]
    message: Annotated[str, about("one sentence with the likely cause")]


class RateDocument(Document):
    """The times of the poses, controls or sightings of a log, in seconds since its first pose."""

    name: Annotated[Literal["poses", "controls", "sightings"], about("what is counted")]
    count: Annotated[Count, about("their number")]
    rate: Annotated[float | None, about("different times per second, the median")]
    longest_gap: Annotated[float | None, about("longest time between two [s]")]
    gap_at: Annotated[float | None, about("when it begins [s]")]


class SeenDocument(Document):
    """The sightings of one landmark."""

    id: Annotated[int, about("id of the landmark")]
    count: Annotated[Count, about("number of sightings")]
    first: Annotated[float, about("time of the first one since the first pose [s]")]
    last: Annotated[float, about("time of the last one [s]")]
    range: Annotated[float, about("median range [m]")]


class HistogramDocument(Document):
    """A histogram."""

    edges: Annotated[list[float], about("limits of the intervals, one more than counts")]
    counts: Annotated[list[Count], about("number of values in each interval")]


class ShowDocument(Document):
    """`slam-compare show`."""

    log: LogDocument
    seconds: Annotated[float | None, about("from the first pose to the last [s]")]
    distance: Annotated[float | None, about("distance driven according to the odometry [m]")]
    turned: Annotated[float | None, about("sum of all turns [rad]")]
    rates: Annotated[list[RateDocument], about("of poses, controls and sightings")]
    landmarks: Annotated[list[SeenDocument], about("by number of sightings")]
    ranges: Annotated[HistogramDocument, about("of the sightings [m]")]
    bearings: Annotated[HistogramDocument, about("of the sightings [rad]")]
    warnings: Annotated[list[FindingDocument], about("what is probably wrong, with the likely cause")]


class FoundDocument(Document):
    """A log or pose graph that was found and read."""

    path: Annotated[str, about("file or folder")]
    robot: Annotated[int | None, about("the robot, where a folder has several")]
    poses: Annotated[Count, about("number of poses")]
    sightings: Annotated[Count, about("number of sightings; of a pose graph, of all edges")]
    landmarks: Annotated[Count, about("number of landmarks")]
    controls: Annotated[Count | None, about("number of controls")]
    seconds: Annotated[float | None, about("from the first pose to the last [s]")]
    poses_covered: Annotated[Count | None, about("number of poses whose ground truth is known")]
    notes: Annotated[list[str], about("remarks of the reader")]
    error: Annotated[str | None, about("why it cannot be read")]


class DataSetDocument(Document):
    """A known data set."""

    name: Annotated[str, about("short name")]
    title: Annotated[str, about("full name")]
    source: Annotated[str, about("where it is published")]
    terms: Annotated[str, about("terms of use")]
    layout: Annotated[str, about("files that the folder must have")]
    is_graph: Annotated[bool, about("whether it has pose graphs instead of logs")]
    found: Annotated[list[FoundDocument], about("the local copies")]


class DatasetsDocument(Document):
    """`slam-compare datasets`."""

    folder: Annotated[str, about("the folder that was searched")]
    exists: Annotated[bool, about("whether there is such a folder")]
    sets: Annotated[list[DataSetDocument], about("the known data sets")]


class CalibrateDocument(Document):
    """`slam-compare calibrate`."""

    source: Annotated[Literal["truth", "residuals"], about("what the noise was estimated from")]
    motion: Annotated[dict[str, Any] | None, about("fields of `graphslam.MotionModel`; null without controls")]
    sensor: Annotated[dict[str, Any], about("fields of `graphslam.SensorModel`")]
    wheel_scale: Annotated[float, about("recorded speed = wheel_scale * speed")]
    turn_scale: Annotated[
        float, about("recorded turn rate = turn_scale * turn rate + turn_rate_bias + curvature_bias * speed")
    ]
    turn_rate_bias: Annotated[float, about("the bias of that line [rad/s]")]
    curvature_bias: Annotated[float, about("its part per speed [rad/m]")]
    range_scale: Annotated[float, about("measured range = range_scale * range + range_bias")]
    range_bias: Annotated[float, about("the bias of that line [m]")]
    bearing_bias: Annotated[float, about("measured bearing = bearing + bearing_bias [rad]")]
    sensor_delay: Annotated[float, about("how late the times of sightings are [s]")]
    errors: Annotated[
        dict[str, float | None],
        about("standard error of each number, by its name; null near zero, or where the log does not tell the number"),
    ]
    bounds: Annotated[
        dict[str, float | None], about("upper 95 % bound of each number near zero; null where the log gives none")
    ]
    degrees: Annotated[
        dict[str, float | None], about("degrees of freedom of Student's t, from the truth; null: normal distribution")
    ]
    counts: Annotated[dict[str, Count], about("number of motions and sightings that were used")]
    misread: Annotated[
        float | None, about("part of the sightings whose id is wrong, or that show no landmark; null from the truth")
    ]
    inflation: Annotated[
        float, about("factor on the variances of the sensor with which its correlated errors count as independent")
    ]
    logs: Annotated[list[str], about("names of the logs")]
    notes: Annotated[list[str], about("remarks of the calibration")]
    doubts: Annotated[list[str], about("why the noise may be wrong, or is not recommended")]
