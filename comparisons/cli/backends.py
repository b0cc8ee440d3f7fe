"""The verb ``backends``: pose graphs through this solver and its peers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import OUTPUT, JsonFile
from .support import Output, sentences

if TYPE_CHECKING:
    from ..backends import BackendRow


def backends(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Pose graphs: g2o, TORO or iSAM text.")],
    backends: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...", help="graphslam, gtsam-lm, gtsam-gn, g2o-gn, g2o-lm.", show_default="all installed"
        ),
    ] = None,
    initialize: Annotated[
        str, typer.Option(help="Where graphslam starts: auto, given, dead-reckoning or rotation-first.")
    ] = "auto",
    same_start: Annotated[
        bool, typer.Option("--same-start", help="All start from the headings-first state, not from the file's values.")
    ] = False,
    repeat: Annotated[int, typer.Option(help="The time is the median of so many runs.", min=1)] = 5,
    max_iterations: Annotated[int, typer.Option(help="For every backend.", min=1)] = 100,
    format: Annotated[str | None, typer.Option(help="g2o, toro or isam.", show_default="by its tags")] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Also draw chi2 over time (.png, .pdf, .svg).", rich_help_panel=OUTPUT)
    ] = None,
    json: JsonFile = None,
) -> None:
    """Time this solver against GTSAM and g2o on pose graphs; chi2 of all by one evaluator."""
    with sentences():
        from ..backend_report import backends_figure, backends_remarks, backends_table
        from ..backends import BACKENDS, compare_backends
        from ..plots import save_figure
        from ..saving import check_can_draw
        from ..tables import seconds

        output = Output(json)
        if figure is not None:
            check_can_draw(figure)
        names = None if backends is None else [name.strip() for name in backends.split(",") if name.strip()]
        with output.bar("backends", len(files) * len(names or BACKENDS)) as advance:

            def told(row: BackendRow) -> None:
                advance(1, f"{Path(row.file).name} {row.backend}")
                output.detail(f"{Path(row.file).name} {row.backend}: {seconds(row.seconds)}, {row.reason}")

            outcome = compare_backends(
                files, backends=names, initialize=initialize, same_start=same_start, repeat=repeat,
                max_iterations=max_iterations, format=format, progress=told,
            )  # fmt: skip
        output.console.print(backends_table(outcome))
        output.say(*backends_remarks(outcome))
        output.json(outcome.to_json())
        if figure is not None:
            save_figure(backends_figure(outcome), [figure])
            output.hint(f"Wrote {figure}.")
