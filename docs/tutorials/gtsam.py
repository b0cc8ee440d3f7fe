# %% graph
import gtsam
import numpy as np

from graphslam import SensorModel
from graphslam.factors import LandmarkFactor, MotionFactor, ResidualFactor, VirtualMotionFactor

X, sensor = gtsam.symbol_shorthand.X, SensorModel()
truth = np.array([[0, 0, 0], [1, 0, 0.3], [1.9, 0.3, 0.6], [2.6, 1.0, 0.9]])
tags = np.array([[3.0, 1.0, 0.2], [1.5, 2.5, -1.0]])
sigmas = gtsam.noiseModel.Diagonal.Sigmas

graph = gtsam.NonlinearFactorGraph()
graph.add(gtsam.PriorFactorPose2(X(0), gtsam.Pose2(*truth[0]), sigmas([0.01, 0.01, 0.01])))
graph.add(gtsam.BetweenFactorPose2(X(0), X(1), gtsam.Pose2(1.1, 0.1, 0.25), sigmas([0.2, 0.2, 0.1])))
graph.add(MotionFactor(X(1), X(2), control=[0.32, 0.1], dt=3.0))  # nu [m/s], omega [rad/s]
graph.add(MotionFactor(X(2), X(3), control=[0.33, 0.1], dt=3.0))

# %% sightings
graph.add(LandmarkFactor([X(k) for k in range(4)], sensor.h(truth, tags[0]), sensor, weight="marginal"))
graph.add(VirtualMotionFactor(X(1), X(3), sensor.h(truth[1], tags[1]), sensor.h(truth[3], tags[1]), sensor))

# %% own_factor
gps = truth[3, :2]
graph.add(ResidualFactor([X(3)], lambda x: x[:2] - gps, information=25 * np.eye(2)))

# %% optimise
initial = gtsam.Values()
for k in range(4):
    initial.insert(X(k), gtsam.Pose2(*(truth[k] + 0.1)))
result = gtsam.LevenbergMarquardtOptimizer(graph, initial).optimize()
estimate = np.array([[p.x(), p.y(), p.theta()] for p in (result.atPose2(X(k)) for k in range(4))])
print("largest difference from the ground truth:", np.abs(estimate - truth).max().round(3))
print("J, twice the error of GTSAM:", round(2 * graph.error(result), 3))
marginals = gtsam.Marginals(graph, result)
print("standard deviation of pose 3, in its own axes:", np.sqrt(marginals.marginalCovariance(X(3)).diagonal()).round(3))
assert graph.error(result) < graph.error(initial)

# %% same
from graphslam import Graph, simulate, solve, solve_with_gtsam

log = simulate(seed=0, clean=True)
ours = Graph.from_log(log, weight="marginal")
hand, reference = solve(ours), solve_with_gtsam(ours)
print("J:", round(hand.cost, 6), round(reference.cost, 6))
print("largest difference of a pose:", f"{np.abs(hand.poses - reference.poses).max():.0e}")
assert np.isclose(hand.cost, reference.cost) and np.allclose(hand.poses, reference.poses, atol=1e-8)
