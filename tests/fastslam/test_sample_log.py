"""The acceptance of the foundation: FastSLAM 1.0 beside the graph on the sample log."""

import numpy as np
import pytest

from fastslam import FastSLAM1
from graphslam import Graph, load, sample_log_path, solve
from graphslam.metrics import ate


@pytest.mark.slow
def test_median_error_over_twenty_seeds_is_within_twice_the_graphs():
    log = load(sample_log_path())
    graph = ate(log.true_poses, solve(Graph.from_log(log, edges="virtual+motion", kernel="none")).poses)
    errors = [ate(log.true_poses, FastSLAM1(log, particles=1000, seed=seed).run().poses) for seed in range(20)]
    assert np.median(errors) <= 2 * graph
