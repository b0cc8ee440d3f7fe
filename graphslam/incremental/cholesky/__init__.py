"""The numba factorisation of the online solver; batch solutions use the engine."""
