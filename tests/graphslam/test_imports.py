"""Public names are imported at their first use; what is not used is not loaded."""

import subprocess
import sys
from dataclasses import fields

import pytest

import graphslam
from graphslam import MotionModel, SensorModel, World
from graphslam.simulation.simulator import MotionFaults, SensorFaults

HEAVY = (
    "gtsam",
    "pebble",
    "scipy.stats",
    "scipy.io",
    "scipy.optimize",
    "scipy.sparse",
    "scipy.spatial",
    "scipy.linalg",
)


@pytest.mark.slow
def test_only_what_is_needed_is_imported():
    program = f"""if True:
        import sys
        from graphslam import Graph, Log, MotionModel, SensorModel, Solution, World, load, save, simulate, solve, textbook
        solve(Graph.from_log(simulate(steps=9))).certificate
        print(*(name for name in {HEAVY!r} if name in sys.modules))
    """
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert done.stdout.split() == []


def test_every_public_name_exists():
    for name in graphslam.__all__:
        assert getattr(graphslam, name) is not None
    assert set(graphslam.__all__) <= set(dir(graphslam))
    with pytest.raises(AttributeError, match="no attribute 'Lok'"):
        graphslam.Lok  # noqa: B018


@pytest.mark.parametrize("kind", [MotionModel, SensorModel, MotionFaults, SensorFaults, World])
def test_every_option_has_help(kind):
    for f in fields(kind):
        assert len(f.metadata["help"]) > 10 and not f.metadata["help"].endswith(".")
        assert isinstance(f.metadata["unit"], str)
