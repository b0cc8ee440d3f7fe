"""Solvers of a graph: the hand-written Omega/xi iteration and its starts, graduated non-convexity, and GTSAM's."""

#: where the iteration of a solver starts: the choices of its option ``initialize``
INITIALIZE = ("auto", "given", "dead-reckoning", "rotation-first", "grow")
