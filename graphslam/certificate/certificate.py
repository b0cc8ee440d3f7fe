"""`Certificate`: what is proven about the cost of a state, and the words for it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..se2 import Array

GLOBAL, NOT_PROVEN, NOT_APPLICABLE = "global", "not proven", "not applicable"
#: a global minimum of the cost with the weights of a robust kernel held at those of the state, ...
GLOBAL_WEIGHTS = "global for its weights"
#: ... with the parameters of the graph held at their values, ...
GLOBAL_HELD = "global with the parameters held"
#: ... and with both held
GLOBAL_WEIGHTS_HELD = "global for its weights with the parameters held"
#: the relative gap up to which a state counts as a global minimum, and J itself where all residuals are zero to rounding
PROVEN = 1e-6


@dataclass(frozen=True)
class Certificate:
    """A bound on how far the cost J of a state is above the global minimum, and its status.

    Attributes:
        status: "global": no state has a cost below ``lower_bound``, and ``relative_gap`` is at most `PROVEN`;
            "global with the parameters held": the same among all states with the values that the parameters of the graph
            have. Other values of them may have a lower cost.
            "global for its weights": with a robust kernel, the same about the cost in which the kernel's weights are held at
            those of the state. This is necessary for a global minimum of J, and not sufficient (see `prove`);
            "global for its weights with the parameters held": both.
            "not proven": there may be a lower minimum, or not; "not applicable": edges stand outside of the theory.
        lower_bound: no state has a lower J in exact arithmetic; 0 where nothing better is known, and always with a kernel;
            NaN where not applicable.
        relative_gap: (J - lower_bound) / J, between 0 and 1; 0 where J is zero up to rounding; NaN where not applicable, or
            where no bound above 0 is known. With a kernel it is that of the cost with the weights held.
        reason: one sentence.
        seconds: the time of the check.
        direction: (n, 2) complex changes of z and t (unit complex headings, complex positions) along which the function below
            J falls, where S has a negative direction; None otherwise.
    """

    status: str
    lower_bound: float
    relative_gap: float
    reason: str
    seconds: float
    direction: Array | None = field(default=None, repr=False)

    @property
    def proven(self) -> bool:
        """Whether the global minimum is proven; the status names what is held fixed for that."""
        return self.status in (GLOBAL, GLOBAL_WEIGHTS, GLOBAL_HELD, GLOBAL_WEIGHTS_HELD)

    @property
    def applicable(self) -> bool:
        """Whether the theory covers the graph."""
        return self.status != NOT_APPLICABLE

    def of_run(self, converged: bool, reason: str) -> Certificate:
        """The certificate of a solver's end: "not proven" where the solver has not converged, however tight the bound is."""
        if converged or not self.applicable:
            return self
        also = "" if self.proven else f"; {self.reason}"
        return replace(self, status=NOT_PROVEN, reason=f"the solver has not converged: {reason}{also}")
