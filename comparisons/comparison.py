"""Several estimators on one log: `run` runs them, `Comparison` holds, measures and saves the outcome."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, overload

import numpy as np

from graphslam import GraphError, Log, MotionModel, SensorModel, SlamError, Solution
from graphslam.association import AssociationScore, score
from graphslam.association.map_states import LandmarkState
from graphslam.calibration import Calibration
from graphslam.files import path_of
from graphslam.log import UNIDENTIFIED
from graphslam.log_checks import Finding, check_log
from graphslam.metrics import Metrics, evaluate, position_errors
from graphslam.se2 import Array, difference

from .estimators import ESTIMATORS, check_estimators, default_estimators
from .estimators.attempt import Skipped, attempts
from .estimators.config import config_text, copies_of
from .estimators.filters import Announce, announce_memory
from .options import AUTO, DOUBTFUL, MODELS, LimitOptions, OutputOptions, RunOptions, options_of
from .options.reading import LogOrPath, prepare
from .options.toml_files import write_noise
from .results import Displayed, EstimatorResult, noted, typical_costs
from .results.documents import LogDocument, SolvedSession, describe, jsonable, one_of, solved_sessions, write_json
from .results.files import SavedFiles, fill_results, new_directory, texts, write_pose_graph
from .results.results import Row, found_ids, parameters_of


@dataclass(frozen=True, repr=False)
class ResultTable(Displayed, Sequence[Row]):
    """The rows of a comparison under their title; indexed by number or by the name of the estimator."""

    title: str
    rows: tuple[Row, ...]

    def __repr__(self) -> str:
        return str(self)

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, index: int | str) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, index: int | str | slice) -> Row | tuple[Row, ...]:
        return {row.name: row for row in self.rows}[index] if isinstance(index, str) else self.rows[index]


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Displayed):
    """The results of several estimators on one log. A notebook shows table, remarks and figure.

    Attributes:
        log: what the estimators worked on.
        results: in the order of the estimators.
        skipped: the estimators that failed, and those of the default list that cannot run on this log or would take too
            long, with the reason.
        source: the file or folder of the log, where there is one; of several logs that of each.
        options: of the run, noise models filled in.
        estimators: the names that were asked for; None for all.
        time_limit: of each estimator [s]; None for none.
        given: the options as they were given.
        copies: of the files that these name, by option: the name of a copy beside the configuration, and what writes it.
        alone: of several logs, what the graph solvers of `ALONE` find for each log by itself, by name; None where one failed.
    """

    log: Log
    results: tuple[EstimatorResult, ...]
    skipped: tuple[Skipped, ...] = ()
    source: Path | tuple[Path | None, ...] | None = None
    options: RunOptions = field(default_factory=RunOptions)
    estimators: tuple[str, ...] | None = None
    time_limit: float | None = None
    given: RunOptions = field(default_factory=RunOptions)
    copies: Mapping[str, tuple[str, Callable[[Path], object]]] = field(default_factory=dict)
    alone: Mapping[str, tuple[EstimatorResult | None, ...]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Comparison({self.log.name!r}: {', '.join(result.name for result in self.results)})"

    @property
    def models(self) -> dict[str, MotionModel | SensorModel]:
        """The noise models, {"motion", "sensor"}."""
        motion, sensor = self.options.models(self.log.motion, self.log.sensor)
        return {"motion": motion, "sensor": sensor}

    @property
    def noise_source(self) -> dict[str, str]:
        """Where each noise model comes from: "book", "log" (or its reader), "file", "estimated" from this log, or "given"."""
        found = self.options.calibration
        if self.options.noise == AUTO:
            # numbers beside --noise auto come first; of several logs no estimate is that of all
            same = {n: _noise(used) == _noise(getattr(found, n, None) or used) for n, used in self.models.items()}
            return {name: "estimated" if as_found else "given" for name, as_found in same.items()}
        if self.options.noise is not None:
            return dict.fromkeys(self.models, "file")
        of_book = {name for name, used in self.models.items() if _noise(used) == _noise(MODELS[name]())}
        of_log = {name for name, used in self.models.items() if used == getattr(self.log, name)}
        return {name: "book" if name in of_book else "log" if name in of_log else "given" for name in self.models}

    @property
    def noise_ratio(self) -> tuple[str, float] | None:
        """The first estimator with a cost, except the lectures' program, and its J per degree of freedom; None if none."""
        solved = (r for r in self.results if r.cost_per_dof is not None and r.name != "textbook")
        return next(((r.name, r.cost_per_dof or 0.0) for r in solved), None)

    @cached_property
    def metrics(self) -> dict[str, Metrics]:
        """The metrics of every result against the ground truth, by name."""
        truth, landmarks = self.log.true_poses, self.log.true_landmarks
        # a row that does not count between two sessions, so that no motion leads from the one to the other
        ends = [drive.start for drive in self.log.drives[1:]]
        truth = None if truth is None else np.insert(truth, ends, np.nan, axis=0)
        return {
            r.name: evaluate(
                truth, landmarks, np.insert(self.log.at_truth(r.poses), ends, 0.0, axis=0), r.landmarks,
                mask=np.insert(r.estimated, ends, False), named=r.named,
            )
            for r in self.results
        }  # fmt: skip

    @cached_property
    def position_errors(self) -> dict[str, Array]:
        """The position error of each pose (T+1,) [m] after the alignment, by name; of results with two poses that count."""
        log = self.log
        return {
            r.name: position_errors(log.true_poses, log.at_truth(r.poses), mask=r.estimated)
            for r in self.results
            if log.true_poses is not None and np.count_nonzero(r.estimated & log.covered) >= 2
        }

    @cached_property
    def nees(self) -> dict[str, float | None]:
        """The mean NEES of every result, by name; None where truth or covariances are not known."""
        return {result.name: result.nees(self.log.robot_truth) for result in self.results}

    @cached_property
    def associations(self) -> dict[str, AssociationScore | None]:
        """The association of every result against the true ids, by name; None where either is not known.

        Ids that were kept say nothing about those that were found.
        """
        true = self.log.landmarks
        found = {r.name: r.association for r in self.results if r.found is None or not r.found.kept.any()}
        known = bool(np.any(true != UNIDENTIFIED))
        scored = {name: score(ids, true) for name, ids in found.items() if known and ids is not None}
        return {r.name: scored.get(r.name) for r in self.results}

    def __getitem__(self, name: str) -> EstimatorResult:
        """The result of an estimator.

        Raises:
            KeyError: it is not among the results.
        """
        return {result.name: result for result in self.results}[name]

    def __contains__(self, name: object) -> bool:
        return any(result.name == name for result in self.results)

    @cached_property
    def table(self) -> ResultTable:
        """The metrics as a table, results and skipped estimators in the order of the registry."""
        rows = [self._row(result) for result in self.results]
        rows += [Row(name=entry.name, skipped=entry.reason, reason=entry.reason) for entry in self.skipped]
        order = {name: k for k, name in enumerate(ESTIMATORS)}
        rows.sort(key=lambda row: order.get(row.name, len(order)))
        return ResultTable(f"{self.log.name}: {self.log.sizes}", tuple(rows))

    def _row(self, result: EstimatorResult) -> Row:
        metrics, name, parameters = self.metrics[result.name], result.name, result.parameters
        found: dict[str, Any] = {
            "nees": self.nees[name], "notes": self.notes_of(result), "result": result,
            "association": found_ids(self.log, result, self.associations[name]),
            "parameters": None if parameters is None else parameters_of(parameters),
        }  # fmt: skip
        same = {f.name for f in fields(Row)} - {"skipped", *found}
        return Row(**found, **{each: getattr(metrics if hasattr(metrics, each) else result, each) for each in same})

    def difference(self, first: str = "graph", second: str = "gtsam") -> float | None:
        """The largest difference of two results in any x, y [m] or heading [rad] that both estimated, or None."""
        if first not in self or second not in self:
            return None
        a, b = self[first], self[second]
        both = a.estimated & b.estimated
        return float(np.max(np.abs(difference(a.poses[both], b.poses[both])))) if both.any() else None

    def notes_of(self, result: EstimatorResult) -> tuple[str, ...]:
        """The notes of a result, with the reason where its NEES is not known because its covariances are not."""
        failure = result.covariance_failure if self.log.true_poses is not None else None
        return result.notes if failure is None else (*result.notes, failure)

    def to_json(self, files: Mapping[str, Path] | None = None) -> dict[str, Any]:
        """The comparison as plain data; what cannot be known is None, and a skipped estimator has only a reason.

        Args:
            files: what was saved, {"figure": path, ...}; the notes of `SavedFiles` become those of the document.
        """
        source = None if isinstance(self.source, tuple) else self.source
        noise = {name: Noise(self.noise_source[name], model) for name, model in self.models.items()}
        document = RunDocument(
            log=describe(self.log, source), noise=noise, sessions=solved_sessions(self), robot=self.options.calibration,
            map_states=self.options.landmark_states, estimators=self.table.rows, files=dict(files or {}),
            notes=getattr(files, "notes", []), warnings=[finding.message for finding in self.findings],
        )  # fmt: skip
        return jsonable(document)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What is probably wrong with the log, see `graphslam.log_checks`, with its noise, or with ids that were found."""
        # the same ids serve several estimators
        verdicts = [each.found.verdict for each in self.results if each.found]
        unreliable = {str(verdict) for verdict in verdicts if not verdict.reliable}
        maps = tuple(Finding("unreliable ids", f"{self.log.name}: {verdict}") for verdict in sorted(unreliable))
        return (*check_log(self.log), *self._noise_findings(), *maps, *self._unused_options())

    def _unused_options(self) -> Iterator[Finding]:
        """Options that were given, and that none of the estimators uses."""
        users = {n: [name for name, each in ESTIMATORS.items() if n in each.uses] for n in options_of(RunOptions)}
        tried = {each.name for each in self.results} | {each.name for each in self.skipped}
        solved, found = not tried.isdisjoint(users["front_end"]), any(each.found is not None for each in self.results)
        for option, _ in self.options.changed():
            # a filter may find the ids of graphs
            by_front_end = option.name == "association" or (option.model == "filter" and found)
            if users[option.name] and tried.isdisjoint(users[option.name]) and not (solved and by_front_end):
                others = ", ".join(users[option.name])
                yield Finding("unused option", f"no estimator of this run uses {option.flag}; {others} would")

    def _noise_findings(self) -> Iterator[Finding]:
        """Noise that was given, such as that of another robot, or estimated, and is less than this log shows.

        On 29 drives (`Drive.random`, seeds 1000 to 1029, at most 150 s) all ratios are at most 1.3 with the noise estimated
        from the drive. With half the noise of the sensor one is above 2 on 15 of the 16 whose errors are not correlated; J
        does not show it where they are.
        """
        if self.noise_ratio is None:
            return
        name, ratio = self.noise_ratio
        medians = typical_costs(self[name])
        misfits = {kind: median for kind in ("relations", "positions") if (median := medians.pop(kind, 0.0)) > DOUBTFUL}
        for kind, median in misfits.items():
            known = "the map" if self.options.landmark_map is not None else "odometry and sightings"
            yield Finding(
                "misfit",
                f"half of the {kind} contradict {known}: in the median, their squared errors are {median:.1f} times those "
                "that their covariances say; they may be in another frame, or their noise is larger",
            )
        sources = {"given", "log", "file", "estimated"} & set(self.noise_source.values())
        if not sources:
            return
        fit = f"J per degree of freedom of {name} is {ratio:.1f}, and should be about 1"
        if medians:
            shown = " and ".join(f"{value:.1f} for {each}" for each, value in medians.items())
            fit += f"; in the median it is {shown}"
        if max(medians.values(), default=ratio) > DOUBTFUL:
            both = "the noise of odometry and that of sightings cannot both be right"
            whose = both if len(medians) > 1 else "they are too small"
            question = "Do they belong to another robot, or are sightings wrong? Compare with --noise auto"
            if sources == {"estimated"}:
                question = "Perhaps the robot slips, or the sightings of several landmarks are wrong together"
            text = f"the noise models say less noise than this log shows, so that {whose}: {fit}. {question}"
            yield Finding("too little noise", text)
        elif ratio > DOUBTFUL and not misfits:
            checked = self.options.check_ids or sources == {"estimated"}
            by_ids = "" if checked else ", such as by misread ids, which --check-ids corrects"
            text = f"{fit}: the noise models fit most sightings, and some sightings are wrong{by_ids}"
            yield Finding("wrong sightings", text)

    @property
    def config(self) -> str:
        """The configuration of this run as TOML; ``slam-compare run --config`` repeats the run from it."""
        return self._config({})

    def _config(self, copies: Mapping[str, str]) -> str:
        return config_text(self.source, self.estimators, self.given, time_limit=self.time_limit, copies=copies)

    def save(
        self, directory: str | PathLike[str] | None = None, *, figures: Sequence[str] = OutputOptions().figures,
        language: str = "en",
    ) -> SavedFiles:  # fmt: skip
        """Write all files into a folder, or none where the folder cannot be written.

        A file that cannot be made for another reason, such as the figure, is left out with a note.

        comparison.json (docs/schema.json), the figure, trajectories NAME.tum and maps NAME-map.csv (see `results.files`), of
        solved graphs NAME-map.npz with the joint covariance of the landmarks, for ``--map`` with other logs, the
        graph as graph.g2o where pose-graph files can hold it, noise and biases that were estimated from the log as
        noise.toml, for ``--noise`` with other logs of the robot, and the configuration as config.toml, with copies of the
        noise file and of the map that were given.

        Args:
            directory: made where it does not exist; default: a new ``results/<time>/``, to which ``results/latest``
                then points.
            figures: the formats of the figure: png, pdf, svg.
            language: of the figure: "en" or "ja".

        Returns:
            {"json": path, "figure": path, "config": path, ...}: "figure" in the first format, "figure_pdf" and so on in
            the others, and the other files by their names; its ``notes`` say what is missing, and why.

        Raises:
            OptionError: a format is unknown.
            FormatError: the folder cannot be made or written.
        """
        figures = OutputOptions.of(figures=figures).figures
        timed = directory is None
        directory = new_directory() if directory is None else path_of(directory)
        files = SavedFiles({"json": directory / "comparison.json"})
        pictures = {f"figure_{kind}" if i else "figure": f"comparison.{kind}" for i, kind in enumerate(figures)}
        with fill_results(directory, new=timed) as folder:
            with noted(files.notes, "there is no figure"):
                if pictures:
                    self.save_figure([folder / name for name in pictures.values()], language=language)
                files |= {kind: directory / name for kind, name in pictures.items()}
            for name, write in self._writers():
                with noted(files.notes, f"there is no {name}"):
                    write(folder / name)
                    files["config" if name == "config.toml" else name] = directory / name
            write_json(self.to_json(files), folder / files["json"].name)
        return files

    def _writers(self) -> Iterator[tuple[str, Callable[[Path], object]]]:
        """The files beside JSON and figure by name, with what writes each."""
        names = {option: name for option, (name, _) in self.copies.items()}
        yield from self.copies.values()
        for name, text in (("config.toml", lambda: self._config(names)), *texts(self)):
            yield name, lambda path, text=text: path.write_text(text(), encoding="utf-8")  # type: ignore[misc]
        for result in self.results:
            if isinstance(result.origin, Solution) and result.landmarks and result.named:
                yield f"{result.name}-map.npz", lambda path, solution=result.origin: solution.map.save(path)  # type: ignore[misc]
        if (found := self.options.calibration) is not None:
            yield "noise.toml", lambda path: write_noise(found, path, self.log.name)
        if "graph" in self:
            yield "graph.g2o", partial(write_pose_graph, self["graph"])


@dataclass(frozen=True)
class Noise:
    """A noise model of the run.

    Attributes:
        source: book: the lectures' values; log: those of the log or its reader; file: a noise file; estimated: from this log;
            given: by options.
        model: fields of `graphslam.MotionModel` or `graphslam.SensorModel`.
    """

    source: Annotated[str, one_of("book", "log", "file", "estimated", "given")]
    model: MotionModel | SensorModel


@dataclass(frozen=True, kw_only=True)
class RunDocument:
    """The JSON of `slam-compare run` (comparison.json), `report` and `associate`.

    Attributes:
        noise: the noise models `motion` and `sensor` of all estimators.
        sessions: the logs, where several were solved as one; null for one log.
        robot: noise and biases that were estimated from the log; null where none were.
        map_states: the landmarks of the map and new ones; null without a map.
        estimators: in the order of the table.
        files: the files written, by kind or name.
        notes: files that could not be made, one sentence each.
        warnings: what is probably wrong with the log, with the likely cause.
    """

    log: LogDocument
    noise: Mapping[str, Noise]
    sessions: list[SolvedSession] | None
    robot: Calibration | None
    map_states: Sequence[LandmarkState] | None
    estimators: tuple[Row, ...]
    files: Mapping[str, Path]
    notes: list[str]
    warnings: list[str]


#: the estimators that solve each of several logs by itself, too, since that takes them no time
ALONE = ("graph", "graph-marginal", "graph-no-kernel")
#: called with a name when an estimator begins (None) and when it is done
Progress = Callable[[str, EstimatorResult | Skipped | None], None]


def run(
    log: LogOrPath | Sequence[LogOrPath] = None, *, estimators: Sequence[str] | str | None = None,
    time_limit: float | None = None, progress: Progress | None = None, **options: Any,
) -> Comparison:  # fmt: skip
    """Run estimators on a log: ``run().table``, ``run("my.npz", estimators=["graph", "gtsam"], edges="virtual")``.

    Args:
        log: a log, the file or folder of one, or None for the sample log of the package; or a list of several logs of one
            place, which are joined (`graphslam.join_logs`).
        estimators: names from `estimators.ESTIMATORS`; default: all. One that fails or cannot run on this log becomes a
            row with the reason, as does one that is not named and would take too long or repeat another.
        time_limit: of each estimator [s], without loading modules. One that takes longer is stopped and becomes a row with
            the reason. The estimators then run in a process of their own.
        progress: called with (name, None) before each estimator and (name, outcome) after it.
        options: the fields of `options.RunOptions`: stride, noise, range_std, edges, kernel, particles, seed, ...

    Raises:
        FormatError: a file cannot be read.
        OptionError: an option or estimator is unknown or impossible.
        GraphError: the log has no sightings, relations or positions.
        SlamError: no estimator has a result; the error is that of the first one that was tried.
    """
    return compare(log, RunOptions.of(**options), estimators=estimators, time_limit=time_limit, progress=progress)


def compare(
    log: LogOrPath | Sequence[LogOrPath], options: RunOptions, *, estimators: Sequence[str] | str | None = None,
    time_limit: float | None = None, progress: Progress | None = None, announce: Announce | None = None,
) -> Comparison:  # fmt: skip
    """The same as `run`, with the options as one object; ``announce`` is called where filters need much memory."""
    names = None if estimators is None else check_estimators(estimators)
    time_limit = LimitOptions.of(time_limit=time_limit).time_limit
    given = options
    data, source, options = prepare(log, given, together=True)
    copies = copies_of(given)
    if len(data.steps) == 0 and not data.measured:
        farthest = options.max_range
        within = "" if farthest is None else f" within max_range ({farthest:g} m)"
        raise GraphError(f"{data.name} has no sightings at all{within}, so there is nothing to estimate from")
    chosen = names or default_estimators()
    announce_memory(((name, data, options) for name in chosen), announce)
    outcomes, report = list[EstimatorResult | Skipped](), progress or (lambda _name, _outcome: None)
    with attempts(chosen, time_limit) as attempt:
        for name in chosen:
            report(name, None)
            reason = ESTIMATORS[name].reason_to_omit(data, options) if names is None else None
            outcomes.append(attempt(name, data, options) if reason is None else Skipped(name, reason))
            report(name, outcomes[-1])
        results = tuple(each for each in outcomes if isinstance(each, EstimatorResult))
        skipped = tuple(each for each in outcomes if isinstance(each, Skipped))
        alone = dict[str, tuple[EstimatorResult | None, ...]]()
        for name in [r.name for r in results if data.sessions and r.name in ALONE]:
            drives = (data.at_steps(np.arange(each.start, each.stop)).replace(sessions=()) for each in data.drives)
            found = [attempt(name, drive, options) for drive in drives]
            alone[name] = tuple(None if isinstance(each, Skipped) else each for each in found)
    if not results:
        # what was tried says more than what was left out beforehand
        first = next((each for each in skipped if each.error is not None), skipped[0])
        if isinstance(first.error, SlamError):
            raise first.error
        raise SlamError(f"no estimator has a result; {first.name} {first.outcome}: {first.reason}") from first.error
    return Comparison(data, results, skipped, source, options, names, time_limit, given, copies, alone)


def _noise(model: MotionModel | SensorModel) -> dict[str, Any]:
    """The noise of a model: not where the sensor is and what it can see, which is known of robots whose noise is not."""
    return {name: value for name, value in vars(model).items() if name not in getattr(model, "GEOMETRY", ())}
