"""Several estimators on one log: `compare` runs them, `Comparison` holds, measures, shows and saves the outcome."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from graphslam import GraphError, Log, MotionModel, OptionError, SensorModel, SlamError
from graphslam.checks import check_choice
from graphslam.metrics import Metrics, evaluate
from graphslam.se2 import wrap

from .estimator import EstimatorResult, RunOptions
from .estimators import ESTIMATORS
from .results import fill_whole, jsonable, new_directory, point_latest, write_json
from .shown import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

    from .config import RunConfig


#: the formats that figures can be written in; a run writes the first two unless told otherwise
FIGURE_FORMATS = ("png", "pdf", "svg")


@dataclass(frozen=True)
class Skipped:
    """An estimator that did not run on this log, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class Row:
    """One line of the table; None where a figure does not exist or cannot be known."""

    name: str
    converged: bool | None = None
    iterations: int | None = None
    seconds: float | None = None
    cost: float | None = None
    ate_m: float | None = None
    rpe_m: float | None = None
    rpe_rad: float | None = None
    landmark_rmse_m: float | None = None
    skipped: str | None = None


@dataclass(frozen=True)
class ResultTable(Shown, Sequence[Row]):
    """The rows of a comparison under their title; indexed by number or by the name of the estimator."""

    title: str
    rows: tuple[Row, ...]

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, index: int | str) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, index: int | str | slice) -> Row | tuple[Row, ...]:
        if isinstance(index, str):
            return {row.name: row for row in self.rows}[index]
        return self.rows[index]

    def shown(self) -> tuple[list[Table], list[str]]:
        """See `Shown`."""
        from .tables import comparison_table

        return [comparison_table(self)], []


@dataclass(frozen=True, eq=False)
class Comparison(Shown):
    """What several estimators made of one log. A notebook shows table, remarks and figure.

    Attributes:
        log: what they were given.
        results: what came out, in the order of the estimators.
        skipped: the estimators of the default list that cannot run on this log.
        source: the file of the log, where there is one.
        options: what the estimators were told, noise models filled in.
    """

    log: Log
    results: tuple[EstimatorResult, ...]
    skipped: tuple[Skipped, ...] = ()
    source: Path | None = None
    options: RunOptions | None = None

    @cached_property
    def metrics(self) -> dict[str, Metrics]:
        """The figures of every result against the truth, by name."""
        truth, landmarks = self.log.true_poses, self.log.true_landmarks
        return {
            r.name: evaluate(truth, landmarks, r.poses, r.landmarks, mask=r.estimated, named=r.named)
            for r in self.results
        }

    def __getitem__(self, name: str) -> EstimatorResult:
        """The result of an estimator.

        Raises:
            KeyError: it is not among the results.
        """
        for result in self.results:
            if result.name == name:
                return result
        raise KeyError(name)

    def __contains__(self, name: object) -> bool:
        return any(result.name == name for result in self.results)

    @cached_property
    def table(self) -> ResultTable:
        """The figures as a table, results and skipped estimators in the order of the registry."""
        rows = [_row(result, self.metrics[result.name]) for result in self.results]
        rows += [Row(name=entry.name, skipped=entry.reason) for entry in self.skipped]
        order = list(ESTIMATORS)
        rows.sort(key=lambda row: order.index(row.name) if row.name in order else len(order))
        log = self.log
        title = f"{log.name}: {log.num_poses} poses, {len(log.steps)} sightings of {len(log.landmark_ids)} landmarks"
        return ResultTable(title, tuple(rows))

    def figure(self) -> Figure:
        """Paths and map on the left, errors (or convergence) on the right; see `plots.comparison_figure`."""
        from .plots import comparison_figure  # matplotlib, only where a figure is wanted

        return comparison_figure(self)

    def shown(self) -> tuple[list[Table], list[str]]:
        """See `Shown`."""
        from .tables import comparison_remarks, comparison_table

        return [comparison_table(self.table)], comparison_remarks(self)

    def _repr_html_(self) -> str:
        from .plots import png_as_html

        return super()._repr_html_() + png_as_html(self.figure())

    def difference(self, first: str = "graph", second: str = "gtsam") -> float | None:
        """The largest difference of two results in any x, y [m] or heading [rad] that both estimated, or None."""
        if first not in self or second not in self:
            return None
        a, b = self[first], self[second]
        both = a.estimated & b.estimated
        if not both.any():
            return None
        off = a.poses[both] - b.poses[both]
        off[:, 2] = wrap(off[:, 2])
        return float(np.max(np.abs(off)))

    def to_json(self, files: Mapping[str, Path] | None = None) -> dict[str, Any]:
        """The comparison as plain data; what cannot be known is None, and skipped estimators have only a reason.

        Args:
            files: what was saved, {"figure": path, ...}.
        """
        by_name = {r.name: _result_json(r, self.metrics[r.name]) for r in self.results}
        by_name |= {entry.name: _skipped_json(entry) for entry in self.skipped}
        payload = {
            "log": describe(self.log, self.source),
            "estimators": [by_name[row.name] for row in self.table],
            "files": {kind: str(path) for kind, path in (files or {}).items()},
        }
        return jsonable(payload)

    def save(
        self, directory: str | PathLike[str] | None = None, *, formats: Sequence[str] = FIGURE_FORMATS[:2],
        config: RunConfig | None = None,
    ) -> dict[str, Path]:  # fmt: skip
        """Write everything into a folder, all or nothing.

        comparison.json (docs/json.md), the figure, trajectories NAME.tum and maps NAME-map.csv (see `exchange`), the
        graph as graph.g2o where pose-graph files can hold it, and, if given, the configuration.

        Args:
            directory: made if need be; default: a new ``results/<time>/``, to which ``results/latest`` then points.
            formats: of the figure, from `FIGURE_FORMATS`.
            config: what the run was told, for ``slam-compare run --config``.

        Returns:
            {"json": path, "figure": path, ...}: "figure" in the first format, "figure_pdf" and so on in the others,
            "config" where it was given, and the other files by their names.

        Raises:
            OptionError: a format is unknown.
            FormatError: the folder cannot be made or written.
        """
        from .exchange import texts, write_pose_graph
        from .plots import save_figure  # matplotlib, only where a figure is wanted

        formats = tuple(dict.fromkeys(formats))
        for kind in formats:
            check_choice("the format of a figure", kind, FIGURE_FORMATS)
        timed = directory is None
        directory = new_directory() if directory is None else Path(directory)
        names = {"json": "comparison.json"}
        names |= {f"figure_{kind}" if i else "figure": f"comparison.{kind}" for i, kind in enumerate(formats)}
        if config is not None:
            names["config"] = "config.toml"
        former = _written_before(directory)
        with fill_whole(directory, for_this_only=timed) as folder:
            for name, text in texts(self):
                (folder / name).write_text(text, encoding="utf-8")
                names[name] = name
            if write_pose_graph(self, folder / "graph.g2o") is None:
                names["graph.g2o"] = "graph.g2o"
            files = {kind: directory / name for kind, name in names.items()}
            if formats:
                save_figure(self.figure(), [folder / f"comparison.{kind}" for kind in formats])
            write_json(self.to_json(files), folder / names["json"])
            if config is not None:
                (folder / names["config"]).write_text(config.to_toml(), encoding="utf-8")
        for name in former - {path.name for path in files.values()}:
            # of an earlier run into the same folder: beside these results they would look like theirs
            (directory / name).unlink(missing_ok=True)
        if timed:
            point_latest(directory)
        return files


def _written_before(directory: Path) -> set[str]:
    """The names of the files that an earlier comparison left in a folder, as its comparison.json tells."""
    try:
        told = json.loads((directory / "comparison.json").read_text(encoding="utf-8"))["files"].values()
        names = {Path(name).name for name in told if Path(name).parent.name == directory.name}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return set()
    return {name for name in names if (directory / name).is_file()}


#: called with a name when an estimator begins (None) and when it is done
Progress = Callable[[str, EstimatorResult | Skipped | None], None]


def compare(
    log: Log,
    estimators: Sequence[str] | None = None,
    options: RunOptions | None = None,
    *,
    source: Path | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Run estimators on a log.

    Args:
        log: what the robot did and saw.
        estimators: names from `ESTIMATORS`; default: all. One that is named has to run. One of the default list that
            cannot run on this log, or would take far too long, becomes a row with its reason; except ``graph``: a
            comparison without it has nothing to say.
        options: what they are told; default: the book's models, and the graph that fits the log.
        source: the file of the log, for the record.
        progress: called with (name, None) before each estimator and (name, outcome) after it.

    Raises:
        OptionError: there is no such estimator.
        SlamError: a named estimator, or ``graph``, cannot run on this log.
    """
    options = with_models(options or RunOptions(), log)
    names = tuple(ESTIMATORS) if estimators is None else _checked(estimators)
    if len(log.steps) == 0:
        raise GraphError(f"{log.name} has no sightings at all, so there is nothing to estimate from")
    results: list[EstimatorResult] = []
    skipped: list[Skipped] = []
    for name in names:
        if progress is not None:
            progress(name, None)
        outcome = _run_one(name, log, options, must_run=estimators is not None or name == "graph")
        if isinstance(outcome, Skipped):
            skipped.append(outcome)
        else:
            results.append(outcome)
        if progress is not None:
            progress(name, outcome)
    return Comparison(log, tuple(results), tuple(skipped), source, options)


def with_models(options: RunOptions, log: Log) -> RunOptions:
    """The options with the noise models that nobody gave: those of the log, else the book's."""
    return replace(
        options,
        motion=options.motion or log.motion or MotionModel(),
        sensor=options.sensor or log.sensor or SensorModel(),
    )


def _run_one(name: str, log: Log, options: RunOptions, *, must_run: bool) -> EstimatorResult | Skipped:
    estimator = ESTIMATORS[name]
    if not must_run and (reason := estimator.too_slow(log)) is not None:
        return Skipped(name, reason)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            result = estimator.run(log, options)
    except SlamError as error:
        if must_run:
            raise
        return Skipped(name, str(error))
    return _with_warnings(result, caught)


def _with_warnings(result: EstimatorResult, caught: Sequence[warnings.WarningMessage]) -> EstimatorResult:
    """What an estimator warned of becomes its notes; warnings meant for programmers go on their way."""
    ours = [w for w in caught if issubclass(w.category, (UserWarning, RuntimeWarning))]
    for warning in caught:
        if warning not in ours:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    texts = dict.fromkeys(str(warning.message) for warning in ours)
    return replace(result, notes=(*result.notes, *texts)) if texts else result


def _checked(estimators: Sequence[str]) -> tuple[str, ...]:
    names = (estimators,) if isinstance(estimators, str) else tuple(dict.fromkeys(estimators))
    for name in names:
        if name not in ESTIMATORS:
            raise OptionError(f"there is no estimator {name!r}; the estimators are {', '.join(ESTIMATORS)}")
    if not names:
        raise OptionError(f"name at least one estimator: {', '.join(ESTIMATORS)}")
    return names


def _row(result: EstimatorResult, metrics: Metrics) -> Row:
    return Row(
        name=result.name,
        converged=result.converged,
        iterations=result.iterations,
        seconds=result.seconds,
        cost=result.cost,
        ate_m=metrics.ate_m,
        rpe_m=metrics.rpe_m,
        rpe_rad=metrics.rpe_rad,
        landmark_rmse_m=metrics.landmark_rmse_m,
    )


def describe(log: Log, source: Path | None = None) -> dict[str, Any]:
    """A log in a few numbers and with its truth, for JSON."""
    return {
        "name": log.name,
        "file": source,
        "poses": log.num_poses,
        "sightings": len(log.steps),
        "landmarks": len(log.landmark_ids),
        "dimensions": log.sightings.shape[1],
        "has_controls": log.controls is not None,
        "controls": None if log.controls is None else len(log.controls),
        "poses_covered": int(np.count_nonzero(log.covered)),
        "true_poses": log.true_poses,
        "true_landmarks": log.true_landmarks,
        "notes": list(log.notes),
    }


def _result_json(result: EstimatorResult, metrics: Metrics) -> dict[str, Any]:
    return {
        "name": result.name,
        "converged": result.converged,
        "iterations": result.iterations,
        "step_norms": result.step_norms,
        "cost": result.cost,
        "seconds": result.seconds,
        "ate_m": metrics.ate_m,
        "rpe_m": metrics.rpe_m,
        "rpe_rad": metrics.rpe_rad,
        "heading_rad": metrics.heading_rad,
        "landmark_rmse_m": metrics.landmark_rmse_m,
        "poses_counted": metrics.poses_counted,
        "poses": result.poses,
        "estimated": result.estimated,
        "landmarks": result.landmarks,
        "landmark_covariances": result.landmark_covariances,
        "options": result.options,
        "reason": result.reason,
        "notes": list(result.notes),
    }


def _skipped_json(entry: Skipped) -> dict[str, Any]:
    unknown = ("converged", "iterations", "step_norms", "cost", "seconds", "ate_m", "rpe_m", "rpe_rad")
    unknown_too = (
        "heading_rad",
        "landmark_rmse_m",
        "poses_counted",
        "poses",
        "estimated",
        "landmarks",
        "landmark_covariances",
    )
    figures: dict[str, Any] = dict.fromkeys((*unknown, *unknown_too))
    return {"name": entry.name} | figures | {"options": {}, "reason": entry.reason, "notes": []}
