from comparisons.kernels import filters, sampled_association


def test_the_kernels_are_called_as_the_solvers_call_them():
    """All run; that they leave numba nothing to compile is seen by the clock of make compare."""
    filters()
    sampled_association()
