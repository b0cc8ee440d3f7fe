"""A factor's measurement can be read back, saved, copied and built anew."""

import copy
import gc
import json
import pickle

import gtsam
import numpy as np
import pytest

from graphslam import FormatError, MotionModel, OptionError, SensorModel
from graphslam.edges.robust import Huber
from graphslam.factors import (
    AnchorFactor,
    FactorDescription,
    InverseObservationFactor,
    LandmarkFactor,
    MotionFactor,
    ObservationFactor,
    RelativePointFactor,
    RelativePoseFactor,
    ResidualFactor,
    VirtualMotionFactor,
    describe,
    load_factors,
    save_factors,
)

sensor = SensorModel(range_rate=0.1)
Z = [[1.0, 0.2, 0.3], [1.5, -0.2, 0.1], [2.0, 0.4, -0.5]]
AT = [[0.0, 0.1, 0.2], [1.0, 0.0, 0.3], [0.5, 0.5, 0.4]]
FACTORS = {
    "anchor": lambda: AnchorFactor(0, [1, 2, 3], np.diag([1.0, 2.0, 3.0])),
    "virtual": lambda: VirtualMotionFactor(0, 1, Z[0], Z[1], sensor, scale=2.0),
    "virtual world": lambda: VirtualMotionFactor(0, 1, Z[0][:2], Z[1][:2], sensor, frame="world", at=(AT[0], AT[1])),
    "virtual robust": lambda: VirtualMotionFactor(0, 1, Z[0], Z[1], kernel=Huber(2.0)),
    "relative": lambda: RelativePoseFactor(0, 1, [1, 2, 3], np.eye(3), frame="world", at=AT[0]),
    "motion": lambda: MotionFactor(0, 1, [0.2, 0.1], 3.0, MotionModel(nn=0.5), scale=3.0),
    "observation": lambda: ObservationFactor(0, 2, Z[0], sensor),
    "polar observation": lambda: ObservationFactor(0, 2, Z[0], sensor, residual="polar"),
    "observation without psi": lambda: ObservationFactor(0, 3, Z[0][:2], sensor, scale=0.5, kernel="cauchy"),
    "inverse": lambda: InverseObservationFactor(0, 2, Z[0], sensor, frame="world", at=AT[0]),
    "point": lambda: RelativePointFactor(0, 3, [1, 2], np.eye(2)),
    "landmark": lambda: LandmarkFactor([0, 1, 2], Z, sensor, weight="tempered", trust=[1, 0.5, 1]),
    "landmark twice": lambda: LandmarkFactor([0, 1, 0], np.array(Z)[:, :2], weight="marginal", frame="world", at=AT),
}


@pytest.fixture
def values():
    values = gtsam.Values()
    for key, pose in enumerate(AT):
        values.insert(key, gtsam.Pose2(*pose))
    values.insert(3, gtsam.Point2(1.0, 2.0))
    return values


@pytest.mark.parametrize("name", FACTORS)
def test_a_factor_built_anew_is_the_same(name, values, tmp_path):
    factor = FACTORS[name]()
    description = describe(factor)
    through_json = FactorDescription.from_dict(json.loads(json.dumps(description.to_dict())))
    save_factors([factor], tmp_path / "factors.json")
    others = [
        description.build(),
        through_json.build(),
        pickle.loads(pickle.dumps(factor)),
        copy.deepcopy(factor),
        load_factors(tmp_path / "factors.json").at(0),
    ]
    for other in others:
        assert list(other.keys()) == list(factor.keys())
        assert other.error(values) == factor.error(values)
        a, b = factor.linearize(values), other.linearize(values)
        np.testing.assert_array_equal(a.augmentedJacobian(), b.augmentedJacobian())
        assert describe(other) == description


def test_a_factor_that_only_the_graph_holds_can_be_described():
    graph = gtsam.NonlinearFactorGraph()
    graph.add(VirtualMotionFactor(7, 9, Z[0], Z[1]))
    gc.collect()
    assert type(graph.at(0)) is gtsam.CustomFactor
    description = describe(graph.at(0))
    assert description.kind == "VirtualMotionFactor" and description.keys == (7, 9)
    np.testing.assert_array_equal(description.arguments["z_2"], Z[1])
    rekeyed = description.rekeyed({9: 4})
    assert list(rekeyed.build().keys()) == [7, 4] and rekeyed != description


def test_a_type_registers_itself():
    class HeadingFactor(AnchorFactor):
        pass

    factor = HeadingFactor(4, [0, 0, 1])
    assert type(describe(factor).build()) is HeadingFactor
    assert type(describe(AnchorFactor(4, [0, 0, 1])).build()) is AnchorFactor


def test_repeated_keys_of_a_landmark_are_renamed_together(values):
    factor = LandmarkFactor([0, 1, 0], Z)
    assert list(factor.keys()) == [0, 1]
    moved = describe(factor).rekeyed({0: 2, 1: 0}).build()
    other = gtsam.Values()
    other.insert(2, values.atPose2(0))
    other.insert(0, values.atPose2(1))
    assert list(moved.keys()) == [2, 0] and moved.error(other) == factor.error(values)


def test_others_and_functions_are_refused(tmp_path):
    native = gtsam.PriorFactorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Unit.Create(3))
    theirs = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [0], lambda *_: np.zeros(1))
    for factor in (native, theirs):
        with pytest.raises(OptionError, match="none of the factor types"):
            describe(factor)
    path = tmp_path / "factors.json"
    path.write_text("keep me")
    with pytest.raises(OptionError, match="residual is a function"):
        save_factors([AnchorFactor(0, [0, 0, 0]), ResidualFactor([0], len, np.eye(1))], path)
    assert path.read_text() == "keep me"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is no file of save_factors"),
        ('{"format": "other", "version": 1, "factors": []}', "is no file of save_factors"),
        ('{"format": "graphslam factors", "version": 1, "factors": [3]}', "no description of a factor"),
        (
            '{"format": "graphslam factors", "version": 1, "factors": [{"kind": "os", "keys": [], "arguments": {}}]}',
            "factor 0, .*no factor type 'os'",
        ),
        (
            '{"format": "graphslam factors", "version": 1, '
            '"factors": [{"kind": "AnchorFactor", "keys": [1], "arguments": {"pose": [1, 2]}}]}',
            r"factor 0, AnchorFactor\(1\): pose must be 3 finite numbers",
        ),
        (
            '{"format": "graphslam factors", "version": 1, '
            '"factors": [{"kind": "AnchorFactor", "keys": [1], "arguments": {"where": [1, 2]}}]}',
            "factor 0, .*where",
        ),
        (
            '{"format": "graphslam factors", "version": 1, '
            '"factors": [{"kind": "ObservationFactor", "keys": [1, 2], "arguments": {"z": [1e30, 0]}}]}',
            "factor 0, .*range of z: 1e.30 is too large",
        ),
    ],
)
def test_files_that_are_none(text, message, tmp_path):
    path = tmp_path / "factors.json"
    path.write_text(text)
    with pytest.raises(FormatError, match=message):
        load_factors(path)
    with pytest.raises(FormatError, match="cannot be read"):
        load_factors(tmp_path / "missing.json")


def mixed_graph():
    """GTSAM's own factors, ours and an empty place, in turn; and the function that one has as residual."""

    def gps(x):
        return x[:2] - np.array([1.0, 2.0]), [np.eye(3)[:2]]

    noise = gtsam.noiseModel.Diagonal.Sigmas([0.1, 0.2, 1 / 3])
    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(1 / 3, 0.1, 0.2), noise))
    graph.add(VirtualMotionFactor(0, 1, Z[0], Z[1], kernel="huber"))
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy(2.0), noise)
    graph.add(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(0.9, 0.0, 0.1), robust))
    graph.add(gtsam.PriorFactorPose2(1, gtsam.Pose2(), noise))
    graph.add(ResidualFactor([1], gps, 25 * np.eye(2)))
    graph.remove(3)
    return graph, {"gps": gps}


def test_a_graph_with_factors_of_gtsam_can_be_saved(values, tmp_path):
    graph, functions = mixed_graph()
    save_factors(graph, tmp_path / "graph.json", functions)
    again = load_factors(tmp_path / "graph.json", functions)
    assert again.size() == graph.size() == 5 and again.at(3) is None
    assert [type(again.at(k)) for k in (0, 2)] == [gtsam.PriorFactorPose2, gtsam.BetweenFactorPose2]
    for k in (0, 1, 2, 4):
        assert again.at(k).error(values) == graph.at(k).error(values) > 0
        assert list(again.at(k).keys()) == list(graph.at(k).keys())
    assert isinstance(again.at(2).noiseModel(), gtsam.noiseModel.Robust)
    # a second time the same file
    save_factors(again, tmp_path / "again.json", functions)
    assert (tmp_path / "again.json").read_text() == (tmp_path / "graph.json").read_text()


def test_what_cannot_be_saved_or_loaded_says_why(tmp_path):
    graph, functions = mixed_graph()
    path = tmp_path / "graph.json"
    with pytest.raises(OptionError, match=r"residual is a function.*functions="):
        save_factors(graph, path)
    one = gtsam.noiseModel.Unit.Create(1)
    with pytest.raises(OptionError, match="factor 1, a PoseRotationPrior2D, cannot be saved"):
        save_factors([AnchorFactor(0, [0, 0, 0]), gtsam.PoseRotationPrior2D(0, gtsam.Pose2(), one)], path)
    assert not path.exists()
    save_factors(graph, path, functions)
    with pytest.raises(FormatError, match=r"factor 4: it needs the function 'gps'"):
        load_factors(path)
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {"gtsam": data["gtsam"][:60]}))
    with pytest.raises(FormatError, match="GTSAM cannot read its own factors"):
        load_factors(path, functions)
    path.write_text(json.dumps(data | {"factors": [{"gtsam": 7}]}))
    with pytest.raises(FormatError, match="factor 0: there is no factor 7"):
        load_factors(path, functions)
    path.write_text(json.dumps(data | {"factors": [{"gtsam": "x" * 100_000}]}))
    with pytest.raises(FormatError, match="there is no factor") as raised:
        load_factors(path, functions)
    assert len(str(raised.value)) < 200 + len(str(path))


def test_prints_name_the_factor_types(capfd):
    graph, _ = mixed_graph()
    theirs = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [8], lambda *_: np.zeros(1))
    graph.add(theirs)
    lines = [line for line in str(graph).splitlines() if line.startswith("Factor ")]
    assert "Factor 1: VirtualMotionFactor on 0, 1" in lines and "Factor 4: ResidualFactor on 1" in lines
    assert "Factor 0: PriorFactor on 0" in lines and "Factor 5: CustomFactor on 8" in lines
    assert str(graph.at(1)).startswith("VirtualMotionFactor on 0, 1") and repr(theirs).startswith("CustomFactor on 8")
    graph.print("mine: ", lambda key: f"<{key}>")
    graph.at(1).print("one: ")
    printed = capfd.readouterr().out
    assert printed.startswith("mine: size: 6") and "Factor 1: VirtualMotionFactor on <0>, <1>" in printed
    assert "one: VirtualMotionFactor on 0, 1" in printed


def test_equals_compares_the_measurement():
    factor = RelativePoseFactor(1, 2, [1, 0, 0], np.eye(3))
    assert factor.equals(RelativePoseFactor(1, 2, [1 + 1e-12, 0, 0], np.eye(3)), 1e-9)
    assert not factor.equals(RelativePoseFactor(1, 2, [9, 0, 0], np.eye(3)), 1e-9)
    assert not factor.equals(RelativePoseFactor(1, 3, [1, 0, 0], np.eye(3)), 1e-9)
    assert not factor.equals(RelativePoseFactor(1, 2, [1, 0, 0], np.eye(3), kernel=Huber()), 1e-9)
    assert not factor.equals(MotionFactor(1, 2, [1.0, 0.0], 1.0), 1e-9)
    assert not factor.equals(factor.to_between(), 1e-9)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(RelativePoseFactor(1, 2, [1, 0, 0], np.eye(3)))
    gc.collect()
    assert factor.equals(graph.at(0), 1e-9)
