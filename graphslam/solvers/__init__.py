"""Solvers of a graph: the hand-written Omega/xi iteration and its starts, graduated non-convexity, and GTSAM's."""
