"""Inputs that nobody writes by accident are refused in one sentence, or read."""

from __future__ import annotations

import time
from contextlib import suppress
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fastslam import FastSLAM1, associate
from graphslam import (
    FormatError,
    Graph,
    GraphError,
    Log,
    MotionModel,
    OnlineSolver,
    OptionError,
    SensorModel,
    SlamError,
    calibrate,
    certify,
    estimate_map,
    load,
    save,
    simulate,
    solve,
)
from graphslam.errors import named, quoted
from graphslam.files import TomlFile
from graphslam.graph.transform import relative_graph
from graphslam.log.rows import TableOptions

ODOMETRY = "t,v,w\n" + "".join(f"{k * 0.5},0.5,0.1\n" for k in range(20))


def tables(folder: Path, word: str = "1", column: str = "id", recipe: str = "") -> Path:
    """A folder of tables in which one cell of the sightings is another word."""
    rows = [{"t": f"{k * 0.5 + 0.1}", "id": f"{k % 4}", "range": "2.5", "bearing": "0.2"} for k in range(10)]
    rows[5][column] = word
    lines = ["t,id,range,bearing", *(",".join(row.values()) for row in rows)]
    (folder / "odometry.csv").write_text(ODOMETRY)
    (folder / "sightings.csv").write_text("\n".join(lines) + "\n")
    if recipe:
        (folder / "import.toml").write_text(recipe)
    return folder


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(steps=8, seed=1)


def test_messages_repeat_at_most_80_characters() -> None:
    assert quoted("x" * 80)[-4:] == "...'"
    for value in ("x" * 10**6, "\0" * 500, 10**5000, list(range(10**5)), np.zeros(10**5)):
        assert len(quoted(value)) <= 80
    assert quoted("tag") == "'tag'"
    assert named(["a", "b"]) == "a, b"
    assert named(["x" * 30] * 10) == "x" * 30 + ", " + "x" * 30 + " and 8 more"


@pytest.mark.parametrize("word", [str(2**63), str(2**64), "1e300", str(-(2**63)), '"open', '"a\nb"', "x" * 200_000])
def test_an_id_that_cannot_be_is_refused_with_its_line(tmp_path: Path, word: str) -> None:
    with pytest.raises(FormatError, match=r"sightings.csv:7: ") as raised:
        load(tables(tmp_path, word))
    assert len(str(raised.value)) < 300 + len(str(tmp_path))


@pytest.mark.parametrize(
    ("word", "number"), [("1e17", 10**17), (str(2**63 - 1), 2**63 - 1), (str(2**53 + 1), 2**53 + 1)]
)
def test_large_ids_are_kept_exactly(tmp_path: Path, word: str, number: int) -> None:
    if number == 2**63 - 1:
        # as a floating-point number it is 2^63
        with pytest.raises(FormatError, match="less than 64 bits"):
            load(tables(tmp_path, word))
    else:
        assert number in load(tables(tmp_path, word)).landmark_ids.tolist()


@pytest.mark.parametrize("digits", [25, 5000])
def test_names_that_end_in_many_digits_are_names(tmp_path: Path, digits: int) -> None:
    word = "tag" + "9" * digits
    if digits > 1000:
        with pytest.raises(FormatError, match="letters"):
            load(tables(tmp_path, word))
    else:
        read = load(tables(tmp_path, word))
        assert any("landmarks have names" in note for note in read.notes)
        assert all(len(note) < 300 + len(str(tmp_path)) for note in read.notes)


@pytest.mark.parametrize("column", ["range", "bearing", "t"])
@pytest.mark.parametrize("word", ["x" * 200_000, '"' + "x" * 200_000 + '"', "9" * 5000, '"open', "1.2.3"])
def test_a_cell_that_is_no_number_is_refused_in_a_short_message(tmp_path: Path, column: str, word: str) -> None:
    with pytest.raises(FormatError) as raised:
        load(tables(tmp_path, word, column))
    assert len(str(raised.value)) < 300 + len(str(tmp_path))


@pytest.mark.parametrize(
    "recipe",
    [
        "columns = 3", "[columns]\nodometry = 3", 'columns = "odometry"', "[columns.odometry]\nnu = [1]",
        "[columns.odometry]\nnu = 1.5", '[odometry]\nnu = "' + "9" * 5000 + '"', "[clocks]\nodometry = [1]",
        "[clocks]\nodometry = {a = 1}", "[clocks]\nodometry = 1e30", f"sensor_offset = [{'9' * 400}, 1]",
        f"sensor_yaw = {'9' * 400}", "sensor_yaw = inf", '[odometry]\nfile = "/dev/zero"', "a = " + "[" * 2000 + "]" * 2000,
        "sensor_yaw = " + "9" * 5000, "sensor_yaw = 1e400",
    ],
)  # fmt: skip
def test_a_recipe_of_wrong_types_is_refused(tmp_path: Path, recipe: str) -> None:
    with pytest.raises(SlamError):
        load(tables(tmp_path, recipe=recipe + "\n"))


def test_columns_and_clocks_of_a_recipe_may_be_texts(tmp_path: Path) -> None:
    read = load(tables(tmp_path, recipe='columns = "odometry.nu=v"\nclocks = "sightings=0.2"\n'))
    assert read.num_poses > 3


@pytest.mark.parametrize(
    "options", [{"columns": {"odometry": 3}}, {"columns": {"odometry": {"nu": [1]}}}, {"clocks": {"odometry": [1]}},
                {"columns": 3}, {"sensor_yaw": "x"}, {"sensor_offset": "x"}, {"clocks": {"odometry": 1e30}}],
)  # fmt: skip
def test_table_options_of_wrong_types_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(OptionError):
        TableOptions(**options)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("true_landmark_ids", np.arange(20)), ("true_landmark_ids", np.array(1.0)),
        ("true_landmark_poses", np.zeros((20, 1))),
        ("true_landmark_poses", np.zeros(3)), ("true_landmark_poses", np.array(["x"])), ("sensor", np.zeros(1)),
        ("sensor", np.array(["x"])), ("sensor", np.ones(7, dtype=complex)), ("start_time", np.array(1j)),
        ("motion", np.array(["x" * 100_000])),
        ("start_time", np.array("x" * 100_000)),
        ("motion", np.zeros((2, 2))), ("doubts", np.array(["a"])), ("steps", np.array(["x"])),
    ],
)  # fmt: skip
def test_archives_with_odd_or_short_arrays_are_refused(tmp_path: Path, log: Log, name: str, value: np.ndarray) -> None:
    save(log, tmp_path / "log.npz")
    with np.load(tmp_path / "log.npz") as archive:
        content = {key: archive[key] for key in archive.files}
    np.savez(tmp_path / "odd.npz", **content | {name: value})
    with pytest.raises(FormatError, match="odd.npz") as raised:
        load(tmp_path / "odd.npz")
    assert len(str(raised.value)) < 300 + len(str(tmp_path))


def test_an_archive_that_claims_gigabytes_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    import struct
    import zipfile

    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("steps.npy", b"x")
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, data.rindex(b"PK\1\2") + 24, 3_000_000_000)
    path.write_bytes(bytes(data))
    with pytest.raises(FormatError, match="would take 3.0 GB"):
        load(path)


@pytest.mark.nightly
def test_a_matlab_file_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    import struct
    import zlib

    packer = zlib.compressobj(9)
    first, again = (packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    body = first + 1100 * again
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    (tmp_path / "dataset2.mat").write_bytes(head + struct.pack("<II", 15, len(body)) + body)
    with pytest.raises(FormatError, match="more than 1.1 GB"):
        load(tmp_path / "dataset2.mat", format="lost-in-the-woods")


@pytest.mark.parametrize("seconds", [1e-300, 1e-6])
def test_keep_every_has_a_bound(tmp_path: Path, log: Log, seconds: float) -> None:
    save(log, tmp_path / "log.npz")
    for path in (tmp_path / "log.npz", tables(tmp_path)):
        with pytest.raises(SlamError, match="poses, more than 1,000,000"):
            load(path, keep_every=seconds)


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/full", "pipe"])
def test_devices_and_pipes_are_no_files(tmp_path: Path, path: str) -> None:
    import os

    if path == "pipe":
        path = str(tmp_path / "pipe")
        os.mkfifo(path)
    for read in (load, Graph.from_g2o, lambda p: TomlFile(Path(p))):
        with pytest.raises(FormatError, match="a pipe or device"):
            read(path)  # type: ignore[operator]


@pytest.mark.slow
def test_the_line_of_a_key_is_found_in_linear_time(tmp_path: Path) -> None:
    path = tmp_path / "long.toml"
    path.write_text(
        '[a]\nb = """\nx = 1\n[c]\n"""\n' + "".join(f"# [d] {k}\n" for k in range(50_000)) + "[c]\nd = [\n1,\n]\n"
    )
    file, begin = TomlFile(path), time.process_time()
    assert file.line_of("a.b") == 2
    assert file.line_of("c") == 50_006
    assert file.line_of("c.d") == 50_007
    assert file.line_of("d") is None
    # reading the text once for each of its lines took minutes
    assert time.process_time() - begin < 10


def test_the_line_of_a_key_in_arrays_of_tables(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("x = [{y = 1}]\n[[s]]\na = 1\n[s.v]\nb = 2\n[[s]]\na = 3\n[s.v]\nb.c = 4\n")
    file = TomlFile(path)
    lines = {key: file.line_of(key) for key in ("x[0].y", "s", "s[0].a", "s[0].v.b", "s[1].a", "s[1].v", "s[1].v.b.c")}
    assert lines == {"x[0].y": 1, "s": 2, "s[0].a": 3, "s[0].v.b": 5, "s[1].a": 7, "s[1].v": 8, "s[1].v.b.c": 9}


#: values of types that are right nowhere
WRONG: list[Any] = [
    object(), "x", {"a": 1}, 10**400, [[1, 2], [3]], b"x", 1j, lambda: 1, np.zeros((2, 2)), np.timedelta64(3, "s"),
]  # fmt: skip


@pytest.mark.parametrize("value", WRONG, ids=lambda value: type(value).__name__)
def test_wrong_python_types_are_refused(tmp_path: Path, log: Log, value: Any) -> None:
    graph = Graph.from_log(log)
    calls = [
        *(lambda n=n: log.replace(**{n: value}) for n in ("motion", "sensor", "true_landmarks", "controls", "sightings")),
        *(lambda n=n: Graph.from_log(log, **{n: value}) for n in ("motion", "sensor", "edges", "kernel", "estimate")),
        *(lambda n=n: associate(log, **{n: value}) for n in ("motion", "sensor", "options", "start", "window", "no")),
        *(lambda n=n: calibrate(log, **{n: value}) for n in ("motion", "sensor", "source", "degrees")),
        *(lambda n=n: simulate(**{n: value}) for n in ("steps", "world", "motion", "arena", "turn_rate", "no")),
        lambda: Graph.from_log(value), lambda: associate(value), lambda: calibrate(value), lambda: calibrate(log, value),
        lambda: certify(value, value), lambda: certify(graph, value), lambda: solve(value),
        lambda: save(value, tmp_path / "a.npz"),
        lambda: MotionModel(nn=value), lambda: MotionModel(epsilon=value), lambda: SensorModel(max_range=value),
        lambda: SensorModel(range_std=value), lambda: SensorModel(offset=value), lambda: log.nearer_than(value),
        lambda: graph.with_initial(value), lambda: Log.from_tables(value, value), lambda: load(tmp_path, keep_every=value),
    ]  # fmt: skip
    for call in calls:
        with pytest.raises(SlamError) as raised:
            call()
        assert len(str(raised.value)) < 700


@pytest.mark.parametrize("lag", [None, 4])
def test_an_online_solver_goes_on_where_no_factor_exists(lag: int | None) -> None:
    """Steps after one where nothing could be eliminated once wrote beside the arrays of the tree."""
    rng, solver = np.random.default_rng(0), OnlineSolver(lag=lag)
    usual = solver._backend.system.pivot_tolerance

    def step() -> None:
        control = [0.5, 0.2] + 0.01 * rng.standard_normal(2)
        solver.move(control, 1.0)
        solver.observe([1, 2], [[3.0, 0.1], [4.0, -0.5]] + 0.01 * rng.standard_normal((2, 2)))

    for _ in range(6):
        step()
    # no pivot is twice its diagonal entry
    solver._backend.system.pivot_tolerance = 2.0
    solver.relinearize()
    assert not solver.converged
    with pytest.raises(GraphError, match="do not determine"):
        solver.covariance()
    before = solver.poses
    with pytest.raises(GraphError):
        step()
    solver._backend.system.pivot_tolerance = usual
    np.testing.assert_array_equal(solver.poses, before)
    for _ in range(6):
        step()
    found = copy(solver)
    found.relinearize()
    # an increment of the state costs less than 1e-7 of J, and sightings are known to some centimetres
    np.testing.assert_allclose(solver.poses, found.poses, atol=2e-3)
    assert solver.converged and np.linalg.eigvalsh(solver.covariance()).min() > 0


def test_a_covariance_beyond_double_precision_is_refused() -> None:
    """A motion of 1e8 m, known to 3e-6 m, which the sightings contradict by as much; the answer was NaN."""
    solver = OnlineSolver()
    z = np.full((2, 3), 0.5)
    for _ in range(2):
        solver.move((0.5, 0.1), 1.0)
        solver.observe([1, 2], z)
        with suppress(GraphError):
            solver.move(motion=[1e8, 0.0, 1.0], covariance=1e-11 * np.eye(3))
        solver.observe([1, 2], z)
    try:
        assert np.isfinite(solver.covariance()).all()
    except GraphError as error:
        assert "do not determine" in str(error)
    solver.move((0.5, 0.1), 1.0)
    assert np.isfinite(solver.poses).all()


@pytest.mark.parametrize("kind", ["complex", "M8[s]", "m8[s]"])
def test_complex_numbers_and_times_are_no_numbers(log: Log, kind: str) -> None:
    """NumPy drops imaginary parts with a warning, and counts seconds since 1970 without one."""
    graph, pose = Graph.from_log(log), np.ones(3).astype(kind)
    calls = [
        *(
            lambda n=n: log.replace(**{n: np.resize(pose, np.shape(getattr(log, n)))})
            for n in ("dt", "controls", "initial_poses", "sightings", "steps", "landmarks", "true_poses")
        ),
        lambda: log.replace(true_landmarks={1: pose}), lambda: SensorModel(offset=pose[:2]),
        lambda: MotionModel(nn=pose[0]), lambda: OnlineSolver(motion_weight=pose[0]),
        lambda: certify(graph, np.resize(pose, graph.initial.shape)),
        lambda: graph.with_initial(np.resize(pose, graph.initial.shape)),
        lambda: relative_graph(graph, state=np.resize(pose, graph.initial.shape)),
        lambda: estimate_map(log, log.initial_poses, trust=np.resize(pose, len(log.steps))),
        lambda: OnlineSolver().move(motion=pose, covariance=np.eye(3)), lambda: FastSLAM1(log).observe([1], [pose[:2]]),
    ]  # fmt: skip
    for call in calls:
        with pytest.raises(SlamError):
            call()


@pytest.mark.parametrize("path", [3, None, b"x", [1], 1.5, object()])
def test_a_path_of_another_type_is_refused(log: Log, path: Any) -> None:
    for call in (lambda: load(path), lambda: save(log, path), lambda: Graph.from_g2o(path)):
        with pytest.raises(OptionError, match="path"):
            call()
