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
    ],
)
def test_files_that_are_none(text, message, tmp_path):
    path = tmp_path / "factors.json"
    path.write_text(text)
    with pytest.raises(FormatError, match=message):
        load_factors(path)
    with pytest.raises(FormatError, match="cannot be read"):
        load_factors(tmp_path / "missing.json")
