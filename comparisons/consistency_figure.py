"""The figure of a consistency study: ANEES step by step, with the chi-square band."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from .consistency import ConsistencyStudy
from .plots import paper_figure

#: Okabe and Ito's colours, one line style each
_STYLES = {
    "landmark nodes": ("#0072B2", "-"), "marginal": ("#009E73", "--"), "tempered": ("#E69F00", "-."),
    "pairs": ("#D55E00", ":"), "fastslam1": ("#CC79A7", "-"), "fastslam2": ("#56B4E9", "--"),
}  # fmt: skip


def consistency_figure(outcome: ConsistencyStudy) -> Figure:
    """ANEES / 3 over the steps, one line per estimator, on a logarithmic axis; 1 is the truth."""
    with paper_figure((7.16, 3.2)) as figure:
        axes = figure.subplots()
        low, high = outcome.results[0].step_band
        axes.axhspan(low, high, color="0.85", linewidth=0, label="95 % band")
        axes.axhline(1.0, color="0.4", linewidth=0.8)
        for result in outcome.results:
            colour, line = _STYLES[result.name]
            steps = np.arange(1, len(result.steps) + 1)
            label = result.name if result.anees is None else f"{result.name} (joint {result.anees:.2f})"
            axes.plot(steps, result.steps, color=colour, linestyle=line, label=label)
        axes.set_yscale("log")
        axes.set_xlim(1, outcome.steps)
        axes.set_xlabel("step")
        axes.set_ylabel("ANEES / 3")
        axes.set_title(
            f"{outcome.logs} logs, {outcome.dimensions}-D sensor, {outcome.noise:g} times the book's noise: 1 is the truth"
        )
        figure.legend(loc="outside lower center", ncols=3)
    return figure
