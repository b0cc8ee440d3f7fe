"""Solvers of a graph: the hand-written Omega/xi iteration, its starts, robust solves, and GTSAM's beside them."""
