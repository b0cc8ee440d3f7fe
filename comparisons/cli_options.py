"""The options that several verbs share, each written once.

Numbers of the noise models and of the simulated faults default to None, "as the library has it", so that the help is
shown without importing the library; the defaults shown are checked against the library's by a test.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

GRAPH, NOISE, OUTPUT = "Graph", "Noise models", "Output"

LogFile = Annotated[
    Path | None,
    typer.Argument(metavar="LOG", help="The log to work on.", show_default="the sample log of the package"),
]
LogFormat = Annotated[
    str | None, typer.Option("--format", help="Format of the log: npz, lnpr, ...", show_default="by its content")
]
Dimensions = Annotated[
    int | None,
    typer.Option(
        help="Of the sensor values: 3 insists on psi, 2 leaves it out.", show_default="what the log has", min=2, max=3
    ),
]
JsonFile = Annotated[
    str | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Also write the figures as JSON; - for standard output, and then nothing else there.",
        rich_help_panel=OUTPUT,
    ),
]
Resampling = Annotated[
    str, typer.Option(help="Of the particle filters: systematic, stratified, residual or multinomial.")
]
Association = Annotated[str, typer.Option(help="Of FastSLAM: known ids, or maximum-likelihood, which ignores them.")]
Seed = Annotated[int, typer.Option(help="Of the random numbers; the same seed gives the same result.", min=0)]


def plain(text: str) -> str:
    """Help text whose [m] and [rad] rich does not take for markup."""
    return text.replace("[", r"\[")


def _noise(name: str, default: str, text: str) -> typer.models.OptionInfo:
    return typer.Option(f"--{name}", help=plain(text), show_default=default, rich_help_panel=NOISE)


Nn = Annotated[float | None, _noise("nn", "0.19", "Noise in nu per metre [m/√m].")]
No = Annotated[float | None, _noise("no", "0.001", "Noise in nu per radian [m/√rad].")]
On = Annotated[float | None, _noise("on", "0.13", "Noise in omega per metre [rad/√m].")]
Oo = Annotated[float | None, _noise("oo", "0.2", "Noise in omega per radian [rad/√rad].")]
RangeRate = Annotated[float | None, _noise("range-rate", "0.14", "Noise of the range, per metre of it.")]
BearingStd = Annotated[float | None, _noise("bearing-std", "0.05", "Noise of the bearing [rad].")]
OrientationStd = Annotated[float | None, _noise("orientation-std", "0.05", "Noise of psi [rad].")]
