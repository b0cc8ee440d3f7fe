"""The verb ``consistency``: is the uncertainty that comes out the uncertainty there is?"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from .options import OUTPUT, JsonFile
from .support import Output, sentences


def consistency(
    logs: Annotated[int, typer.Option(help="How many logs to simulate.", min=1)] = 200,
    noise: Annotated[float, typer.Option(help="All standard deviations of the book's models times this.")] = 0.1,
    steps: Annotated[int, typer.Option(help="Motions of each log.", min=1)] = 62,
    dimensions: Annotated[int, typer.Option(help="3 with psi, 2 without.")] = 3,
    estimators: Annotated[
        str,
        typer.Option(
            metavar="NAME,...",
            help="Whom to judge: landmark nodes, marginal, tempered, pairs, fastslam1, fastslam2.",
        ),
    ] = "landmark nodes,marginal,tempered,pairs",
    seed: Annotated[int, typer.Option(help="Of the first log; the others follow.", min=0)] = 0,
    jobs: Annotated[
        int | None, typer.Option(help="Logs at a time.", min=1, show_default="the number of cores, up to 8")
    ] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Also draw ANEES over the steps (.png, .pdf, .svg).", rich_help_panel=OUTPUT)
    ] = None,
    json: JsonFile = None,
) -> None:
    """Average normalised errors (ANEES) over many simulated logs, for each estimator and weight, with the 95 % band."""
    with sentences():
        from ..consistency import study_consistency
        from ..plots import save_figure
        from ..saving import check_can_draw
        from ..tables import consistency_remarks, consistency_table

        output = Output(json)
        if figure is not None:
            check_can_draw(figure)
        names = [name.strip() for name in estimators.split(",") if name.strip()]
        with output.bar("logs", logs) as advance:
            outcome = study_consistency(
                logs=logs, noise=noise, steps=steps, dimensions=dimensions, estimators=names, seed=seed,
                jobs=jobs or min(os.cpu_count() or 1, 8), progress=lambda _: advance(1),
            )  # fmt: skip
        output.console.print(consistency_table(outcome))
        output.say(*consistency_remarks(outcome))
        output.json(outcome.to_json())
        if figure is not None:
            from ..consistency_figure import consistency_figure

            save_figure(consistency_figure(outcome), [figure])
            output.hint(f"Wrote {figure}.")
        output.hint("Next: slam-compare consistency --noise 0.5 shows what the curvature of the models does")
