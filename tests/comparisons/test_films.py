"""Films: what their frames hold, what their files are, and what is refused."""

from __future__ import annotations

import re
import shutil
import subprocess
from base64 import b64decode
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from PIL import Image
from typer.testing import CliRunner

from comparisons.cli import app
from comparisons.estimators import make_graph
from comparisons.estimators.filters import particle_filter
from comparisons.options import AnimationOptions, RunOptions
from comparisons.options.declaration import options_of
from comparisons.show.figures import ellipses
from comparisons.show.films import Film, animate
from comparisons.show.films.graphs import Residuals
from comparisons.show.films.scene import SIZE, Scene, kept
from comparisons.show.language import translated
from fastslam import ParticleGibbs
from graphslam import (
    AbsolutePositions,
    Drive,
    Graph,
    GraphError,
    LandmarkMap,
    Log,
    LogError,
    OptionError,
    PoseRelations,
    SlamError,
    save,
    simulate,
    solve,
    solve_online,
)
from graphslam.log import UNIDENTIFIED
from graphslam.se2 import mounted, transform, wrap

FEW = {"particles": 30, "seed": 4, "gibbs_iterations": 12, "gibbs_warm_up": 4, "gibbs_particles": 5, "gibbs_chains": 2}
ANIMATED = options_of(AnimationOptions)["estimator"].choices


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=12, clean=True)


@pytest.fixture(scope="module")
def film(log: Log) -> Film:
    return animate(log, estimator="fastslam1", **FEW, max_frames=4)


def test_a_film_has_the_iterations_of_all_passes_to_the_estimated_ranges() -> None:
    """The solution counts those of the last pass alone."""
    drive, _ = Drive(seed=3, duration=40.0, misread=0.0).simulate()
    graph = Graph.from_log(drive)
    assert solve(graph).iterations < len(animate(drive, max_frames=100)) - 1


def test_graph_film_is_the_solver_s_way(log: Log) -> None:
    graph = make_graph(log, RunOptions())
    seen = []
    solution = solve(graph, initialize="given", callback=seen.append)
    film = animate(log)
    assert len(film) == film.steps == solution.iterations + 1
    for frame, state in zip(film.frames, [log.initial_poses, *(iteration.state for iteration in seen)]):
        np.testing.assert_allclose(wrap(frame.poses - state), 0, atol=1e-12)
    np.testing.assert_array_equal(film.frames[-1].poses, solution.poses)
    # the values are the Mahalanobis distances of all edges but the anchor, which costs nothing
    np.testing.assert_allclose([np.sum(f.values**2) for f in film.frames], solution.costs, rtol=1e-9)
    for j, place in solution.landmarks.items():
        np.testing.assert_allclose(film.frames[-1].landmarks[j], place)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"weight": "tempered"},
        {"weight": "marginal"},
        {"edges": "landmark+motion"},
        {"edges": "virtual", "frame": "world"},
    ],
)
def test_distances_add_up_to_the_cost(log: Log, options: dict[str, str]) -> None:
    graph = make_graph(log, RunOptions.of(**options))
    lines, distances = Residuals(graph)(graph.initial)
    # the anchor costs nothing where it was cast
    assert np.sum(distances**2) == pytest.approx(graph.cost(graph.initial), rel=1e-9)
    assert lines.shape == (len(distances), 2, 2)
    assert np.all(np.diff(distances) >= 0)
    poses = graph.initial[: len(graph.steps), :2]
    nearest = np.linalg.norm(lines[:, 0, None] - poses, axis=2).min(axis=1)
    np.testing.assert_allclose(nearest, 0, atol=1e-12)


def test_edges_of_other_sensors_are_lines(log: Log) -> None:
    """Of positions from the antenna to where it was measured, of relations between their poses; priors of a map are none."""
    lever, steps = (0.5, 0.1), np.array([4, 9])
    positions = AbsolutePositions(
        steps=steps,
        places=mounted(log.true_poses[steps], lever)[:, :2] + 0.1,
        covariances=0.01 * np.eye(2),
        levers=lever,
    )
    relations = PoseRelations(first=[2], second=[12], motions=[[1.0, 0.0, 0.0]], covariances=0.1 * np.eye(3))
    graph = make_graph(log.replace(positions=positions, relations=relations), RunOptions.of(edges="landmark+motion"))
    lines, distances = Residuals(graph)(graph.initial)
    assert np.sum(distances**2) == pytest.approx(graph.cost(graph.initial), rel=1e-9)
    ends = {tuple(line[1].round(9)) for line in lines}
    assert {tuple(place.round(9)) for place in positions.places[:, :2]} <= ends
    film = animate(log.replace(relations=relations), estimator="fastslam1", **FEW, max_frames=2)
    assert film.notes == ("a particle filter does not use the relations of the log",)
    known = solve(Graph.from_log(log, edges="landmark+motion")).map
    in_map = Graph.from_log(log, map=known)
    assert Residuals(in_map).drawn == Residuals(in_map).count
    assert len(animate(log, landmark_map=known, max_frames=3)) > 1


def test_thinned_edges_keep_their_distances(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    graph = make_graph(log, RunOptions(weight="tempered"))
    _, every = Residuals(graph)(graph.initial)
    monkeypatch.setattr("comparisons.show.films.graphs.MOST_EDGES", 20)
    thinned = Residuals(graph)
    _, some = thinned(graph.initial)
    assert thinned.drawn == len(some) < thinned.count == len(every)
    # each of them is one of the whole: the weight of a pair does not change when others are not drawn
    assert np.abs(some[:, None] - every).min(axis=1).max() < 1e-9


def test_starts_where_the_better_minimum_is() -> None:
    film = animate(edges="landmark+motion", residual="polar")
    assert np.sum(film.frames[-1].values ** 2) == pytest.approx(373.174314, rel=1e-6)
    assert any("from dead reckoning J is 5432.99" in note and "not 373.174" in note for note in film.notes)


@pytest.mark.parametrize("name", ["mcl", "fastslam1", "fastslam2"])
def test_particle_film_is_the_filter_s_way(log: Log, name: str) -> None:
    film = animate(log, estimator=name, **FEW)
    filter = particle_filter(name, log, RunOptions.of(**FEW))
    result = filter.run()
    assert len(film) == log.num_poses
    assert [frame.number for frame in film.frames] == list(range(log.num_poses))
    np.testing.assert_array_equal(film.frames[-1].poses, result.poses)
    assert [f"particles {ess:,.0f} " in f.caption for f, ess in zip(film.frames, result.ess)] == [True] * len(film)
    np.testing.assert_array_equal([bool(f.flash) for f in film.frames], result.resampled)
    assert film.frames[3].poses.shape == (4, 3)
    # the map is that of the best particle; the covariances of the result are over all particles
    for j, estimate in filter.state.map().items():
        np.testing.assert_allclose(film.frames[-1].landmarks[j], result.landmarks[j])
        np.testing.assert_allclose(film.frames[-1].landmark_covariances[j], estimate.covariance)


def test_resamplings_between_pictures_are_counted(log: Log, film: Film) -> None:
    result = particle_filter("fastslam1", log, RunOptions.of(**FEW)).run()
    assert len(film) == 4
    assert film.steps == log.num_poses
    counts = [re.fullmatch(r"resampled(?: (\d+) ×)?", f.flash) for f in film.frames if f.flash]
    assert sum(int(each[1] or 1) for each in counts if each) == result.resampled.sum() > 4


@pytest.mark.parametrize("stage", ["motion", "weights"])
def test_stages_of_the_lectures(log: Log, stage: str) -> None:
    """Particles that only move lose no weight; weighed ones do, and are never replaced."""
    film = animate(log, estimator="fastslam1", stage=stage, **FEW)
    assert film.title.endswith(", not weighed" if stage == "motion" else ", not resampled")
    assert not any(frame.flash for frame in film.frames)
    last = film.frames[-1]
    assert np.ptp(last.values) == 0 if stage == "motion" else np.ptp(last.values) > 0.9
    assert last.landmarks


def test_film_of_samples(log: Log) -> None:
    film = animate(log, estimator="particle-gibbs", **FEW, max_frames=5)
    options = RunOptions.of(**FEW)
    result = ParticleGibbs(log, seed=4, options=options.gibbs).run()
    assert [frame.number for frame in film.frames] == [0, 3, 6, 8, 11]
    np.testing.assert_array_equal(film.frames[-1].poses, result.poses)
    np.testing.assert_array_equal(film.frames[2].paths, result.trajectories[:, 6])  # type: ignore[attr-defined]
    assert film.frames[0].earlier.shape == (0, 13, 3)  # type: ignore[attr-defined]
    assert film.frames[2].earlier.shape == (12, 13, 3)  # type: ignore[attr-defined]
    assert film.notes == (result.mixing.statement,)
    assert "2 chains" in film.title


@pytest.mark.parametrize("edges", ["virtual+motion", "landmark+motion"])
def test_isam2_film_grows(log: Log, edges: str) -> None:
    film = animate(log, estimator="isam2", edges=edges)
    solution = solve_online(log, backend="isam2", edges=edges)
    assert [len(frame.poses) for frame in film.frames] == list(range(1, log.num_poses + 1))
    np.testing.assert_allclose(film.frames[-1].poses, solution.poses, atol=1e-12)
    before, last = film.frames[-2:]
    moved = np.linalg.norm(last.poses[:-1, :2] - before.poses[:, :2], axis=1)
    np.testing.assert_allclose(last.values, [*moved, 0], atol=1e-12)
    for j, place in solution.landmarks.items():
        np.testing.assert_allclose(last.landmarks[j], place, atol=1e-9)


@pytest.mark.parametrize(("count", "most"), [(1, 5), (5, 5), (6, 5), (161, 200), (1000, 7)])
def test_kept_frames(count: int, most: int) -> None:
    numbers = kept(count, most)
    assert len(numbers) == min(count, most)
    assert numbers[0] == 0
    assert numbers[-1] == count - 1
    assert count == 1 or np.ptp(np.diff(numbers)) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ANIMATED)
def test_pictures_change_only_where_something_moves(log: Log, name: str) -> None:
    pictures = animate(log, estimator=name, **FEW, max_frames=3).pictures
    first, last = pictures[0], pictures[-1]
    assert first.dtype == np.uint8
    assert first.shape == last.shape
    assert first.shape[0] % 2 == first.shape[1] % 2 == 0
    assert (first != last).any()
    # the title's line, the axes' numbers and the legend stand still
    np.testing.assert_array_equal(first[-60:], last[-60:])
    np.testing.assert_array_equal(first[:, :50], last[:, :50])
    # and a picture does not depend on those drawn before it
    np.testing.assert_array_equal(pictures[0], first)
    with pytest.raises(IndexError):
        pictures[3]


def test_gif(film: Film, tmp_path: Path) -> None:
    done = []
    path = film.save(tmp_path / "film.gif", progress=lambda: done.append(1))
    with Image.open(path) as image:
        assert image.n_frames == len(film) == len(done)
        durations = []
        for k in range(image.n_frames):
            image.seek(k)
            durations.append(image.info["duration"])
            shown = np.asarray(image.convert("RGB")).astype(int)
            assert (shown[0, 0] == 255).all()
            # the particles of the legend, a few pixels, keep their blue
            assert (np.abs(shown[-60:] - (0, 0x72, 0xB2)).max(axis=2) <= 32).any()
            # 255 colours for antialiased lines: most pixels are as they were drawn
            assert np.mean(np.abs(shown - film.pictures[k]).max(axis=2) > 40) < 0.01
    assert durations == [100, 100, 100, 2000]
    assert [p.name for p in tmp_path.iterdir()] == ["film.gif"]


def test_html_needs_nothing_else(film: Film, tmp_path: Path) -> None:
    text = film.save(tmp_path / "film.html").read_text(encoding="utf-8")
    assert "$" not in re.sub(r"base64,[^\"]*", "", text)
    assert not re.search(r"(src|href)=\"(?!data:)", text)
    assert text.count("data:image/png") == len(film) + 2  # what stands still, and the first picture before any script
    assert len(text) < 2e6
    still, first, *layers = (
        Image.open(BytesIO(b64decode(data))).convert("RGBA")
        for data in re.findall(r"data:image/png;base64,([^\"]*)", text)
    )
    assert first == layers[0]
    for layer, picture in zip(layers, film.pictures, strict=True):
        laid_over = np.asarray(Image.alpha_composite(still, layer))[:, :, :3].astype(int)
        assert np.mean(np.abs(laid_over - picture).max(axis=2) > 40) < 0.01


def test_notebook(film: Film) -> None:
    shown = film._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert "<script>" not in shown


@pytest.mark.slow
def test_mp4(film: Film, tmp_path: Path) -> None:
    if shutil.which("ffmpeg") is None:
        pytest.skip("needs ffmpeg on the PATH")
    path = film.save(tmp_path / "film.mp4")
    command = ["ffmpeg", "-loglevel", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    decoded = subprocess.run(command, capture_output=True, check=True).stdout
    shown = np.frombuffer(decoded, dtype=np.uint8).reshape(-1, *film.pictures[0].shape).astype(int)
    # the last picture stays for two seconds, of which one is its own tenth
    assert len(shown) == len(film) + 19
    for k in (0, len(film) - 1, -1):
        assert np.mean(np.abs(shown[k] - film.pictures[min(k, len(film) - 1)])) < 4


def test_a_failing_ffmpeg_leaves_nothing(film: Film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / "ffmpeg"
    broken.write_text("#!/bin/sh\necho no such codec >&2\nexit 3\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    with pytest.raises(OptionError, match="ffmpeg failed: no such codec"):
        film.save(tmp_path / "film.mp4")
    assert [p.name for p in tmp_path.iterdir()] == ["ffmpeg"]


def test_an_interrupted_film_leaves_the_old_one(film: Film, tmp_path: Path) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    path = tmp_path / "film.gif"
    path.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        film.save(path, progress=interrupt)
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["film.gif"]


@pytest.mark.parametrize(
    ("name", "options", "error", "words"),
    [
        ("gtsam", {}, OptionError, "estimator must be one of graph"),
        ("graph", {"kernel": "gnc"}, OptionError, "gnc solves many"),
        ("isam2", {"kernel": "gnc"}, GraphError, "graduated"),
        ("isam2", {"edges": "virtual"}, GraphError, "motion edges"),
        ("isam2", {"frame": "world"}, GraphError, "world frame"),
    ],
)
def test_refused(log: Log, name: str, options: dict[str, str], error: type[SlamError], words: str) -> None:
    with pytest.raises(error, match=words):
        animate(log, estimator=name, **options)


@pytest.mark.parametrize("name", ["isam2", "particle-gibbs"])
def test_a_map_that_would_not_be_used_is_refused(log: Log, name: str) -> None:
    with pytest.raises(OptionError, match=f"{name} does not use a map"):
        animate(log, estimator=name, landmark_map=solve(Graph.from_log(log)).map)


def test_refused_logs(log: Log) -> None:
    with pytest.raises(OptionError, match="needs a map"):
        animate(log.replace(true_landmarks=None), estimator="mcl", **FEW)
    undriven = log.replace(controls=None, dt=None)
    with pytest.raises(LogError, match="no controls"):
        animate(undriven, estimator="fastslam2", **FEW)
    with pytest.raises(OptionError, match="max_frames"):
        animate(log, max_frames=1)
    with pytest.raises(OptionError, match="fps"):
        animate(log, fps=0)
    blind = log.replace(steps=np.empty(0, int), landmarks=np.empty(0, int), sightings=np.empty((0, 3)))
    with pytest.raises(GraphError, match="no sightings"):
        animate(blind, estimator="fastslam1", **FEW)


@pytest.mark.parametrize("name", ["graph", "fastslam1"])
def test_without_truth_the_whole_map_is_in_sight(log: Log, name: str) -> None:
    film = animate(log.replace(true_poses=None, true_landmarks=None), estimator=name, **FEW, max_frames=2)
    figure = Figure()
    Scene(figure, film).at(film.frames[-1])
    plane = figure.axes[0]
    frame = film.frames[-1]
    curves = ellipses(frame.landmarks, frame.landmark_covariances).reshape(-1, 2)
    for points in (curves, frame.poses[:, :2]):
        assert plane.viewLim.count_contains(points) == len(points) > 0


def test_a_log_without_truth_and_controls_has_a_film(log: Log) -> None:
    film = animate(log.replace(controls=None, dt=None, true_poses=None, true_landmarks=None))
    labels = [text.get_text() for text in _legend(film).get_texts()]
    assert labels == ["dead reckoning", "graph", "map (3σ, given the path)"]


def _legend(film: Film) -> Legend:
    figure = Figure()
    Scene(figure, film)
    return figure.legends[0]


def test_the_caption_of_an_association_has_the_words_of_its_legend(log: Log) -> None:
    film = animate(log, estimator="association", max_frames=2)
    assert re.fullmatch(
        r"step 12    sightings: \d+ certain, \d+ uncertain, \d+ of no landmark", film.frames[-1].caption
    )
    texts = [text.get_text() for text in _legend(film).get_texts()]
    assert texts[-3:] == ["sighting: certain", "sighting: uncertain", "sighting: of no landmark"]
    assert translated(film.frames[-1].caption, "ja").startswith("時刻12　センサ値: 確定")


def test_a_curve_within_a_factor_of_ten_has_room_for_its_name(log: Log) -> None:
    film = animate(log, estimator="isam2", max_frames=4)
    figure = Figure(SIZE)
    scene = Scene(figure, film)
    figure.draw_without_rendering()
    assert scene.strip.yaxis.label.get_window_extent().x0 >= 0


def test_the_film_knows_its_log(log: Log, tmp_path: Path) -> None:
    save(log, tmp_path / "log.npz")
    film = animate(tmp_path / "log.npz", stride=2, max_range=100.0)
    assert film.source == tmp_path / "log.npz"
    assert film.log.num_poses == 7
    assert animate(log, max_frames=2).source is None


class TestCommandLine:
    """The verb, from outside."""

    def run(self, *arguments: object):  # type: ignore[no-untyped-def]
        return CliRunner().invoke(app, ["animate", *map(str, arguments)])

    def test_writes(self, log: Log, tmp_path: Path) -> None:
        save(log, tmp_path / "log.npz")
        out = tmp_path / "out.gif"
        result = self.run(
            tmp_path / "log.npz", out, "--estimator", "fastslam1", "--particles", "20", "--max-frames", "3"
        )
        assert result.exit_code == 0, result.output
        assert f"Wrote {out}: 3 of 13 frames, 10 per second" in result.stdout
        with Image.open(out) as image:
            assert image.n_frames == 3

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["film.avi"], "must end in .gif or .mp4 or .html"),
            (["none.npz", "film.avi"], "must end in .gif or .mp4 or .html"),
            (["none.npz", "film.gif"], "there is no such file"),
            (["nowhere/film.gif"], "there is no such folder"),
            (
                ["film.gif", "--estimator", "gtsam"],
                "must be one of graph, association, fastslam1, fastslam2, mcl, isam2",
            ),
            (["film.gif", "--fps", "-1"], "fps must be a positive number"),
            (["film.gif", "--kernel", "gnc"], "gnc solves many"),
        ],
    )
    def test_refuses(self, arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        result = self.run(*arguments)
        assert result.exit_code == 2
        assert result.stderr.startswith("error: ")
        assert words in result.stderr
        assert result.stderr.count("\n") == 1
        assert not list(tmp_path.iterdir())

    def test_missing_ffmpeg_is_said_before_any_work(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("PATH", str(tmp_path))
        monkeypatch.setattr("comparisons.show.films.animate", None)
        result = self.run(tmp_path / "film.mp4")
        assert result.exit_code == 2
        assert "needs the program ffmpeg: install it, or write a .gif or .html" in result.stderr


@pytest.mark.parametrize("name", ["graph", "fastslam1", "mcl"])
def test_a_film_without_true_poses_shows_the_whole_map(log: Log, name: str) -> None:
    film = animate(log.replace(true_poses=None), estimator=name, **FEW, max_frames=2)
    figure = Figure()
    Scene(figure, film)
    view, true = figure.axes[0].viewLim, np.array([log.true_landmarks[j][:2] for j in log.landmark_ids.tolist()])
    assert view.count_contains(true) == len(true)
    assert "true landmark" in [text.get_text() for text in figure.legends[0].get_texts()]
    bare = Figure()
    Scene(bare, animate(log.replace(true_poses=None, true_landmarks=None), estimator="graph"))
    landmarks = np.array([m[:2] for m in solve(make_graph(log, RunOptions())).landmarks.values()])
    assert bare.axes[0].viewLim.count_contains(landmarks) == len(landmarks)


def test_single_true_poses_have_no_entry_of_their_own(log: Log) -> None:
    """The true pose 5 has no neighbours, so that no line shows it."""
    truth = log.true_poses.copy()
    truth[[4, 6]] = np.nan
    labels = [text.get_text() for text in _legend(animate(log.replace(true_poses=truth), max_frames=2)).get_texts()]
    assert "ground truth" in labels and not [label for label in labels if label.startswith("_")]


def test_localisation_in_a_map_of_other_axes_and_without_a_landmark(log: Log) -> None:
    """The path is drawn where the ground truth is, and what is not on the map is left out, as in a run."""
    seen = log.landmark_ids.tolist()
    places = {j: transform(np.array([100.0, 50.0, 1.0]), log.true_landmarks[j][:2]) for j in seen[1:]}
    filmed = animate(log, estimator="mcl", landmark_map=LandmarkMap(places, {}), max_frames=2, **FEW)
    scene, last = filmed.pictures._scene, filmed.frames[-1].poses
    assert np.max(np.hypot(*(scene.placed(last) - log.true_poses[:, :2]).T)) < 1.0
    assert [note for note in filmed.notes if "landmarks that are not on the map" in note]


def test_landmarks_that_are_numbered_by_discovery_align_nothing(log: Log) -> None:
    unnamed = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED), true_poses=None)
    assert animate(log, max_frames=2).named and not animate(unnamed, max_frames=2).named
