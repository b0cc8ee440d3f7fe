"""The verbs that check and time solvers: solvers, backends."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .output import DIFFERENT, Output
from .verb import LogFile

if TYPE_CHECKING:
    from ..backends import BackendRow
    from ..options import BackendOptions, FigureOptions, SolverCheckOptions
    from ..solvers import SkippedVariant, VariantResult


def solvers(output: Output, log: LogFile = None, *, options: SolverCheckOptions) -> None:
    """Check the hand-written solver against GTSAM on every graph that a log allows; exit status 1 if they differ."""
    from ..solvers import compare_solvers

    with output.bar("variants") as advance:

        def progress(variant: VariantResult | SkippedVariant) -> None:
            advance(1, variant.name)
            output.detail(f"{variant.name}: done")

        outcome = compare_solvers(log, progress=progress, **options.keywords())
    output.show(outcome)
    if not outcome.problems:
        output.say(f"The solvers agree in all {len(outcome.variants)} variants.")
        output.hint("To test whether the covariances are consistent: slam-compare consistency")
    output.json(outcome.to_json())
    if outcome.problems:
        raise typer.Exit(DIFFERENT)


def backends(
    output: Output,
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Pose graphs: g2o, TORO or iSAM text.")],
    *,
    options: BackendOptions,
    drawing: FigureOptions,
) -> None:
    """Time this solver, GTSAM and g2o on pose graphs; the same function computes the chi2 of every solver's result."""
    from ..backends import BACKENDS, compare_backends
    from ..saving import FIGURE_FORMATS, check_can_write

    if drawing.figure is not None:
        check_can_write(drawing.figure, endings=FIGURE_FORMATS)
    with output.bar("backends", len(files) * len(options.backends or BACKENDS)) as advance:

        def progress(row: BackendRow) -> None:
            advance(1, f"{Path(row.file).name} {row.backend}")
            chi2 = f"chi2 {row.chi2:.6g}, {row.seconds:.3g} s, " if row.seconds == row.seconds else ""
            output.progress(f"{Path(row.file).name} {row.backend}: {chi2}{row.reason}")

        outcome = compare_backends(files, progress=progress, **options.keywords())
    output.show(outcome)
    output.json(outcome.to_json())
    output.draw(outcome, drawing.figure)
