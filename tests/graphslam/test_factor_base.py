# ruff: noqa: E501  (a table of one-line abuses)
"""What all factors share: mistakes become exceptions and never a crash, no memory leaks, and arguments are checked."""

import inspect
import subprocess
import sys
import textwrap

import gtsam
import numpy as np
import pytest

from graphslam import FactorError, OptionError, SlamError
from graphslam.factors import (
    AnchorFactor,
    InverseObservationFactor,
    LandmarkFactor,
    MotionFactor,
    ObservationFactor,
    PositionFactor,
    PriorFactor,
    RelativeEdgesFactor,
    RelativePointFactor,
    RelativePoseFactor,
    ResidualFactor,
    VirtualMotionFactor,
    describe,
)

X1, X2, M = gtsam.symbol("x", 1), gtsam.symbol("x", 2), gtsam.symbol("m", 1)
HEAD = """
import gtsam, graphslam, numpy as np
from graphslam import FactorError, OptionError
from graphslam.factors import *
X1, X2, M = gtsam.symbol("x", 1), gtsam.symbol("x", 2), gtsam.symbol("m", 1)
def values(*more):
    v = gtsam.Values()
    v.insert(X1, gtsam.Pose2(0, 0, 0)); v.insert(X2, gtsam.Pose2(1, 0, 0.1))
    for key, value in more: v.insert(key, value)
    return v
def solved(factor, v):
    g = gtsam.NonlinearFactorGraph(); g.add(factor); g.add(gtsam.PriorFactorPose2(X1, gtsam.Pose2(), gtsam.noiseModel.Unit.Create(3)))
    return gtsam.LevenbergMarquardtOptimizer(g, v).optimize()
"""
#: what is abused, in a process of its own: (name, code, the exception and what it must say)
ABUSES = [
    ("missing value", "solved(MotionFactor(X1, M, [1, 0], 1.0), values())", "FactorError", "nothing at its key m1"),
    ("wrong type", "solved(MotionFactor(X1, M, [1, 0], 1.0), values((M, gtsam.Point2(1, 2))))", "FactorError", "m1 is no gtsam.Pose2"),
    ("pose for a point", "solved(RelativePointFactor(X1, X2, [1, 2], np.eye(2)), values())", "FactorError", "x2 is no gtsam.Point2"),
    ("key a word", "MotionFactor('x1', X2, [1, 0], 1.0)", "OptionError", "a key must be an integer"),
    ("key a float", "MotionFactor(1.5, X2, [1, 0], 1.0)", "OptionError", "a key must be an integer"),
    ("key negative", "AnchorFactor(-1, [0, 0, 0])", "OptionError", "from 0 to 2^64 - 1"),
    ("key twice", "MotionFactor(X1, X1, [1, 0], 1.0)", "OptionError", "keys must differ"),
    ("NaN measured", "ObservationFactor(X1, M, [1, float('nan'), 0])", "OptionError", "finite numbers"),
    ("words measured", "VirtualMotionFactor(X1, X2, 'abc', [1, 0, 0])", "OptionError", "finite numbers"),
    ("raises", "solved(ResidualFactor([X1, X2], lambda a, b: 1 / 0, np.eye(3)), values())", "FactorError", "raised ZeroDivisionError"),
    ("NaN residual", "solved(ResidualFactor([X1], lambda a: a * np.nan, np.eye(3)), values())", "FactorError", "not finite"),
    ("short residual", "solved(ResidualFactor([X1], lambda a: a[:2], np.eye(3)), values())", "FactorError", "must have shape (3,)"),
    ("none returned", "solved(ResidualFactor([X1], lambda a: None, np.eye(3)), values())", "FactorError", "must have shape"),
    ("Jacobian 2 x 2", "solved(ResidualFactor([X1], lambda a: (a + 1, [np.eye(2)]), np.eye(3)), values())", "FactorError", "Jacobian 0 must have shape (3, 3)"),
    ("Jacobian 3 x 2", "solved(ResidualFactor([X1], lambda a: (a + 1, [np.ones((3, 2))]), np.eye(3)), values())", "FactorError", "Jacobian 0 must have shape (3, 3)"),
    ("Jacobian missing", "solved(ResidualFactor([X1, X2], lambda a, b: (a - b + 1, [np.eye(3)]), np.eye(3)), values())", "FactorError", "needs 2 Jacobians"),
    ("Jacobian unset", "solved(ResidualFactor([X1], lambda a: (a + 1, [None]), np.eye(3)), values())", "FactorError", "Jacobian 0"),
    ("Jacobian ragged", "solved(ResidualFactor([X1], lambda a: (a + 1, [[[1, 2, 3], [1, 2], [3]]]), np.eye(3)), values())", "FactorError", "Jacobian 0"),
    ("landmark underfoot", "solved(ObservationFactor(X1, M, [1, 0, 0], residual='polar'), values((M, gtsam.Pose2(0, 0, 0))))", "FactorError", "exactly at the robot"),
    ("raises in ISAM2", "i = gtsam.ISAM2(); g = gtsam.NonlinearFactorGraph(); g.add(ResidualFactor([X1], lambda a: 1 / 0, np.eye(3))); v = gtsam.Values(); v.insert(X1, gtsam.Pose2()); i.update(g, v)", "FactorError", "ZeroDivisionError"),
    ("missing in linearize", "MotionFactor(X1, X2, [1, 0], 1.0).linearize(gtsam.Values())", "FactorError", "MotionFactor(x1, x2)"),
    ("bearing in degrees", "ObservationFactor(X1, M, [2, 30, 0])", "OptionError", "orientation of z is 30 rad, beyond 2 pi: is it in degrees?"),
    ("psi in degrees", "VirtualMotionFactor(X1, X2, [2, 0.3, 0.1], [2, 0.1, -90])", "OptionError", "orientation of z_2 is -90 rad, beyond 2 pi"),
    ("bearings in degrees", "LandmarkFactor([X1, X2], [[1, 0.3], [2, -20]])", "OptionError", "orientation of sightings is -20 rad"),
    ("turn rate in degrees", "MotionFactor(X1, X2, [1, 10], 1.0)", "OptionError", "turn rate of control is 10 rad/s"),
    ("anchor in degrees", "AnchorFactor(X1, [0, 0, 90])", "OptionError", "heading of pose is 90 rad, beyond 8 pi: is it in degrees?"),
    ("relative pose in degrees", "RelativePoseFactor(X1, X2, [1, 0, 45], np.eye(3))", "OptionError", "heading of measured is 45 rad"),
    ("frozen in degrees", "MotionFactor(X1, X2, [1, 0], 1.0, frame='world', at=[0, 0, 90])", "OptionError", "heading of at is 90 rad"),
    ("relative edges in degrees", "RelativeEdgesFactor([X1, X2], [0], [1], [[1, 0, 45]], [np.eye(3)])", "OptionError", "heading of measured is 45 rad"),
    ("prior in degrees", "PriorFactor([X1], [[0, 0, 90]], np.eye(3))", "OptionError", "heading of values is 90 rad"),
    ("position in degrees", "PositionFactor(X1, [0, 0, 90], np.eye(3))", "OptionError", "heading of measured is 90 rad"),
    ("more points than keys", "PriorFactor([X1], [[0, 0, 0]], np.eye(3), points=2)", "OptionError", "points must be at most 1"),
    ("turn of one place", "PriorFactor([X1, X2], np.ones((2, 3)), np.eye(6), pivot=[0, 0])", "OptionError", "a pivot needs values at two"),
    ("parts of coordinates", "PriorFactor([X1], [[0, 0, 0]], np.eye(2), coordinates=[2.5])", "OptionError", "coordinates must be 2 or 3"),
    ("complex residual", "solved(ResidualFactor([X1], lambda a: (np.array([1j]), [np.ones((1, 3))]), [[1]]), values())", "FactorError", "it is complex"),
    ("kernel of no kind", "AnchorFactor(X1, [0, 0, 0], kernel=graphslam.edges.robust.Kernel(2.0))", "OptionError", "kernel must be"),
    ("landmark without poses", "LandmarkFactor([], np.zeros((0, 3)))", "OptionError", "at least one sighting"),
    ("landmark rows", "LandmarkFactor([X1, X2], [[1, 0, 0]])", "OptionError", "2 rows of 2 or 3"),
]  # fmt: skip


def run(code):
    return subprocess.run([sys.executable, "-c", HEAD + code], capture_output=True, text=True, timeout=300, check=False)


def test_every_abuse_is_an_exception_and_no_crash():
    """All in one process, which must live to its end."""
    lines = [
        textwrap.dedent(f"""
        try:
            {code}
            print({name!r}, "passed")
        except {error} as e:
            print({name!r}, "raised" if {text!r} in str(e) else "said " + str(e))
        """)
        for name, code, error, text in ABUSES
    ]
    done = run("".join(lines))
    assert done.returncode == 0, f"the process died: {done.returncode}\n{done.stdout}\n{done.stderr}"
    assert done.stdout.splitlines() == [f"{name} raised" for name, *_ in ABUSES]


@pytest.mark.nightly
def test_memory_comes_back():
    """Resident memory after many factors made, used and dropped; the 10^6 of the goal are in benchmarks/factors.py."""
    code = textwrap.dedent("""
    import gc, os
    def resident():
        with open("/proc/self/statm") as f: return int(f.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
    def batch():
        v = values()
        for k in range(3000):
            g = gtsam.NonlinearFactorGraph()
            g.add(VirtualMotionFactor(X1, X2, [1, 0, 0], [1, 0.1, 0])); g.add(MotionFactor(X1, X2, [1, 0], 1.0))
            g.error(v)
    batch(); gc.collect(); before = resident()
    for _ in range(4): batch()
    gc.collect()
    print(before, resident())
    """)
    done = run(code)
    if "statm" in done.stderr:
        pytest.skip("this system has no resident memory in /proc")
    before, after = map(float, done.stdout.split())
    assert after < 1.05 * before


def test_a_residual_of_ones_own_with_and_without_jacobians():
    """x_2 must lie one metre ahead of x_1: the same answer from given and from numeric derivatives."""

    def ahead(a, b):
        c, s = np.cos(a[2]), np.sin(a[2])
        d = b[:2] - a[:2]
        e = np.array([c * d[0] + s * d[1] - 1.0, -s * d[0] + c * d[1]])
        by_a = np.array([[-c, -s, e[1]], [s, -c, -e[0] - 1.0]])
        return e, (by_a, np.array([[c, s, 0.0], [-s, c, 0.0]]))

    values = gtsam.Values()
    values.insert(X1, gtsam.Pose2(0.3, -0.2, 2.0))
    values.insert(X2, gtsam.Pose2(1.0, 0.4, -1.0))
    omega = np.array([[4.0, 1.0], [1.0, 2.0]])
    given = ResidualFactor([X1, X2], ahead, omega)
    numeric = ResidualFactor([X1, X2], lambda a, b: ahead(a, b)[0], omega)
    assert given.error(values) == numeric.error(values)
    np.testing.assert_allclose(
        numeric.linearize(values).jacobian()[0], given.linearize(values).jacobian()[0], atol=1e-7
    )


def test_a_residual_between_a_pose_and_a_point():
    factor = ResidualFactor([X1, M], lambda x, m: m - x[:2], np.eye(2), kinds=["pose", "point"])
    values = gtsam.Values()
    values.insert(X1, gtsam.Pose2(1, 2, 0.5))
    values.insert(M, gtsam.Point2(4, 6))
    assert factor.error(values) == pytest.approx(12.5)
    jacobian, _ = factor.linearize(values).jacobian()
    c, s = np.cos(0.5), np.sin(0.5)
    np.testing.assert_allclose(jacobian, [[-c, s, 0, 1, 0], [-s, -c, 0, 0, 1]], atol=1e-8)


def test_a_number_is_calibrated_with_the_poses():
    """Distances that a sensor reports 5 % too long, between poses that priors hold: the scale is their quotient."""
    graph, start, scale = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.symbol("s", 0)
    for k in range(3):
        graph.add(AnchorFactor(k, (2.0 * k, 0, 0)))
        start.insert(k, gtsam.Pose2(2.0 * k, 0, 0))
    start.insert(scale, 1.0)

    def too_long(a, b, s, exact=True):
        d = (b - a)[:2]
        r = np.hypot(*d)
        e = np.array([s[0] * r - 2.1])
        return (e, [-s[0] * np.array([[*d / r, 0]]), s[0] * np.array([[*d / r, 0]]), [[r]]]) if exact else e

    kinds = ["pose", "pose", "number"]
    for residual in (too_long, lambda a, b, s: too_long(a, b, s, exact=False)):
        graph.add(ResidualFactor([0, 1, scale], residual, np.eye(1), kinds=kinds))
        graph.add(ResidualFactor([1, 2, scale], residual, np.eye(1), kinds=kinds))
        result = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
        assert result.atDouble(scale) == pytest.approx(1.05, abs=1e-6)
    with pytest.raises(FactorError, match="the value at its key 1 is no float"):
        ResidualFactor([0, 1], lambda *at: at[1], np.eye(1), kinds=["pose", "number"]).error(start)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ResidualFactor([X1], "no function", np.eye(3)), "residual must be a function"),
        (lambda: ResidualFactor([X1], len, np.zeros(3)), "d x d matrix"),
        (lambda: ResidualFactor([X1], len, np.zeros((2, 2))), "positive definite"),
        (lambda: ResidualFactor([X1], len, np.eye(2), kinds=["circle"]), "kinds must be one of"),
        (lambda: ResidualFactor([X1], len, np.eye(2), kinds=["pose", "pose"]), "one kind per key"),
        (lambda: LandmarkFactor([X1, X2], [[1, 0], [1, 0]]), r"without psi .* in frame='body', too: pass at=poses"),
        (lambda: LandmarkFactor([X1, X2], [[1, 0, 0], [0, 0, 0]]), "ranges above zero"),
        (lambda: LandmarkFactor([X1, X2], [[1, 0, 0]] * 2, kernel="huber"), r"needs a width, such as Huber\(5\.0\)"),
        (lambda: LandmarkFactor([X1, X2], [[1, 0, 0], [1, 0, 0]], trust=[1, 0]), "trust must be above zero"),
        (lambda: LandmarkFactor([X1, X2], [[1, 0, 0]] * 3), "sightings must be 2 rows of 2 or 3 finite numbers"),
        (lambda: LandmarkFactor(X1, [[1, 0, 0]]), "takes a list of keys"),
        (lambda: ResidualFactor(X1, len, np.eye(3)), "takes a list of keys"),
        (lambda: MotionFactor(X1, X2, [1, 0], 1.0, kernel="l7"), "kernel must be one of"),
        (lambda: VirtualMotionFactor(X1, X2, [1, 0], [1, 0], frame="world", at=([0, 0, 0],) * 2).to_between(), "no relative pose"),
        (lambda: MotionFactor(X1, X2, [1, 0], 1.0, frame="world", at=[0, 0, 0]).to_between(), "frame='body'"),
        (lambda: VirtualMotionFactor(X1, X2, [1, 0, 0], [1, 0, 0], frame="world", at=([0, 0, 0],) * 2).to_between(), "frame='body'"),
        (lambda: ObservationFactor(X1, M, [1, 0], scale=-1), "scale must be a positive"),
        (lambda: ObservationFactor(X1, M, [1, 0], residual="both"), "residual must be one of"),
        (lambda: AnchorFactor(True, [0, 0, 0]), "a key must be an integer"),
        (lambda: RelativePointFactor(X1, M, [1, 2, 3], np.eye(2)), "2 finite numbers"),
    ],
)  # fmt: skip
def test_impossible_arguments(make, message):
    with pytest.raises(OptionError, match=message):
        make()


def test_the_error_names_factor_and_keys():
    with pytest.raises(FactorError, match=r"VirtualMotionFactor\(x1, x2\): the values have nothing at its key x1"):
        VirtualMotionFactor(X1, X2, [1, 0, 0], [1, 0, 0]).error(gtsam.Values())


def test_poses_and_points_of_gtsam_are_taken():
    """A `gtsam.Pose2` stands for (x, y, theta) and a `gtsam.Point2` for (x, y), wherever one is an argument."""
    pose, other, point = gtsam.Pose2(1, 2, 0.5), gtsam.Pose2(0.3, -1, -2), gtsam.Point2(0.5, 1.5)
    x, y = (np.array([p.x(), p.y(), p.theta()]) for p in (pose, other))
    z, omega, world = [[1.0, 0.1, 0.2], [2.0, 0.3, -0.4]], np.eye(3), {"frame": "world"}
    pairs = [
        (AnchorFactor(X1, pose), AnchorFactor(X1, x)),
        (RelativePoseFactor(X1, X2, pose, omega), RelativePoseFactor(X1, X2, x, omega)),
        (RelativePoseFactor(X1, X2, x, omega, **world, at=pose), RelativePoseFactor(X1, X2, x, omega, **world, at=x)),
        (MotionFactor(X1, X2, [1, 0], 1.0, **world, at=pose), MotionFactor(X1, X2, [1, 0], 1.0, **world, at=x)),
        (
            VirtualMotionFactor(X1, X2, *z, **world, at=(pose, other)),
            VirtualMotionFactor(X1, X2, *z, **world, at=(x, y)),
        ),
        (LandmarkFactor([X1, X2], z, **world, at=[pose, other]), LandmarkFactor([X1, X2], z, **world, at=[x, y])),
        (
            InverseObservationFactor(X1, X2, z[0], **world, at=pose),
            InverseObservationFactor(X1, X2, z[0], **world, at=x),
        ),
        (RelativePointFactor(X1, M, point, np.eye(2)), RelativePointFactor(X1, M, [0.5, 1.5], np.eye(2))),
    ]
    values = gtsam.Values()
    values.insert(X1, gtsam.Pose2(0.1, 0.2, 0.3))
    values.insert(X2, gtsam.Pose2(1.1, 0.4, -0.3))
    values.insert(M, gtsam.Point2(4, 6))
    for given, expected in pairs:
        assert given.error(values) == pytest.approx(expected.error(values), rel=1e-12)
        assert describe(given) == describe(expected)
    with pytest.raises(OptionError, match="pose must be 3 finite numbers"):
        AnchorFactor(X1, point)


@pytest.mark.parametrize("problem", [SystemExit, GeneratorExit, ZeroDivisionError])
def test_a_residual_cannot_end_the_program(problem):
    def residual(a):
        raise problem("3")

    values = gtsam.Values()
    values.insert(X1, gtsam.Pose2())
    with pytest.raises(FactorError, match=f"its residual raised {problem.__name__}: 3") as caught:
        ResidualFactor([X1], residual, np.eye(3)).error(values)
    assert isinstance(caught.value.__cause__, problem)


def test_ctrl_c_within_a_residual_stays_ctrl_c():
    def residual(a):
        raise KeyboardInterrupt

    values = gtsam.Values()
    values.insert(X1, gtsam.Pose2())
    graph = gtsam.NonlinearFactorGraph()
    graph.add(ResidualFactor([X1], residual, np.eye(3)))
    with pytest.raises(KeyboardInterrupt):
        gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()


def test_an_object_without_its_constructor_is_refused_and_does_not_crash():
    crashes = """
        factor = VirtualMotionFactor.__new__(VirtualMotionFactor)
        print(repr(factor))
        for use in (lambda: factor.keys(), lambda: factor.error(gtsam.Values()), lambda: describe(factor)):
            try:
                use()
            except (FactorError, OptionError) as error:
                print(error)
    """
    done = subprocess.run([sys.executable, "-c", HEAD + textwrap.dedent(crashes)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("<VirtualMotionFactor without __init__>")
    assert done.stdout.count("made without its constructor") == 2


def test_a_daemon_thread_does_not_abort_the_end_of_python():
    threads = """
        import threading, time
        values, graph = gtsam.Values(), gtsam.NonlinearFactorGraph()
        values.insert(0, gtsam.Pose2())
        graph.add(AnchorFactor(0, [0, 0, 0]))
        def work():
            while True:
                graph.error(values)
        for _ in range(3):
            threading.Thread(target=work, daemon=True).start()
        time.sleep(0.2)
    """
    done = subprocess.run([sys.executable, "-c", HEAD + textwrap.dedent(threads)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


WRONG = [
    None,
    "abc",
    [],
    [[]],
    np.zeros((0, 0)),
    np.nan,
    np.inf,
    10**400,
    1e300,
    [1e300, 0, 0],
    1j,
    object(),
    np.eye(3) * np.nan,
]
GOOD = {
    VirtualMotionFactor: {"key_1": 1, "key_2": 2, "z_1": [2, 0.3, 1.2], "z_2": [1.6, 0.1, 1.3]},
    LandmarkFactor: {"keys": [1, 2], "sightings": [[2, 0.3, 1.2], [1.6, 0.1, 1.3]]},
    ObservationFactor: {"pose_key": 1, "landmark_key": 2, "z": [2, 0.3, 1.2]},
    InverseObservationFactor: {"pose_key": 1, "landmark_key": 2, "z": [2, 0.3, 1.2]},
    MotionFactor: {"key_1": 1, "key_2": 2, "control": [0.2, 0.1], "dt": 3.0},
    RelativePoseFactor: {"key_1": 1, "key_2": 2, "measured": [1, 0, 0.1], "information": np.eye(3)},
    RelativePointFactor: {"pose_key": 1, "landmark_key": 2, "measured": [1, 0], "information": np.eye(2)},
    AnchorFactor: {"key": 1, "pose": [0, 0, 0]},
    PositionFactor: {"key": 1, "measured": [1, 2], "information": np.eye(2)},
    PriorFactor: {"keys": [1], "values": [[0, 0, 0]], "information": np.eye(3)},
    RelativeEdgesFactor: {
        "keys": [1, 2],
        "first": [0],
        "second": [1],
        "measured": np.zeros((1, 3)),
        "information": np.eye(3)[None],
    },
    ResidualFactor: {"keys": [1], "residual": lambda a: a, "information": np.eye(3)},
}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("kind", GOOD)
def test_every_wrong_argument_is_refused_in_a_sentence(kind):
    for name in inspect.signature(kind.__init__).parameters:
        for wrong in WRONG if name != "self" else ():
            try:
                kind(**{**GOOD[kind], name: wrong})
            except SlamError as error:
                assert "\n" not in str(error)


@pytest.mark.parametrize("weight", ["pairs", "marginal"])
def test_sightings_from_one_pose_alone_say_nothing(weight, capfd):
    values = gtsam.Values()
    values.insert(1, gtsam.Pose2())
    factor = LandmarkFactor([1, 1], [[2, 0.3, 1.2], [2, 0.3, 1.2]], weight=weight)
    assert factor.linearize(values).error(values.zeroVectors()) == factor.error(values) == pytest.approx(0, abs=1e-20)
    assert capfd.readouterr().err == ""


def test_noise_models_of_gtsam_are_taken_as_information() -> None:
    deviations = np.array([0.1, 0.2, 0.05])
    values = gtsam.Values()
    values.insert(X1, gtsam.Pose2(0.1, 0.2, 0.3))
    values.insert(X2, gtsam.Pose2(1.2, 0.1, 0.2))
    model = gtsam.noiseModel.Diagonal.Sigmas(deviations)
    for given in (model, gtsam.noiseModel.Gaussian.Covariance(np.diag(deviations**2))):
        one = RelativePoseFactor(X1, X2, (1, 0, 0.1), given)
        other = RelativePoseFactor(X1, X2, (1, 0, 0.1), np.diag(deviations**-2.0))
        assert one.error(values) == pytest.approx(other.error(values), rel=1e-12)
    fix = ResidualFactor([X1], lambda x: x[:2], gtsam.noiseModel.Isotropic.Sigma(2, 0.5))
    assert fix.error(values) == pytest.approx(0.5 * 4 * (0.1**2 + 0.2**2))
    for wrong in (gtsam.noiseModel.Isotropic.Sigma(2, 0.1), [0.1, 0.1, 0.1]):
        with pytest.raises(OptionError, match="or a Gaussian noise model of GTSAM of this size, not "):
            RelativePoseFactor(X1, X2, (1, 0, 0.1), wrong)
