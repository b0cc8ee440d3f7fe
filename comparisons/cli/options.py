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
    typer.Argument(
        metavar="LOG", help="The log to work on: a file, or the folder of a data set.",
        show_default="the sample log of the package",
    ),
]  # fmt: skip
LogFormat = Annotated[
    str | None,
    typer.Option("--format", help="Format of the log: npz, lnpr, mrclam, huang, ...", show_default="by its content"),
]
Robot = Annotated[
    int | None, typer.Option(help="Which robot of a data set that has several.", min=0, show_default=False)
]
KeepEvery = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS", help="Keep a pose at least so often, seen or not.", show_default="where something was seen"
    ),
]
Stride = Annotated[int, typer.Option(help="Keep only every so manieth pose, and what was seen from it.", min=1)]
MaxRange = Annotated[
    float | None, typer.Option(metavar="M", help=r"Leave out what was seen from farther \[m].", show_default=False)
]
NoiseFile = Annotated[
    Path | None,
    typer.Option(
        "--noise", metavar="FILE", help="Noise models that calibrate wrote (TOML); single numbers below beat it.",
        show_default="the log's, else the book's", rich_help_panel=NOISE,
    ),
]  # fmt: skip
RangeScale = Annotated[
    float | None,
    typer.Option(
        help="Measured range = scale * range + bias; undone before anything else.", show_default="1",
        rich_help_panel=NOISE,
    ),
]  # fmt: skip
RangeBias = Annotated[
    float | None, typer.Option(help=r"The bias of that \[m].", show_default="0", rich_help_panel=NOISE)
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
FigureFormats = Annotated[
    str, typer.Option("--figures", metavar="FORMAT,...", help="Of the figure: png, pdf, svg.", rich_help_panel=OUTPUT)
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
SigmaV = Annotated[
    float | None, _noise("sigma-v", "0", "Noise in nu of every control [m/s]; alone it replaces the four above.")
]
SigmaOmega = Annotated[float | None, _noise("sigma-omega", "0", "Noise in omega of every control [rad/s]; likewise.")]
Epsilon = Annotated[float | None, _noise("epsilon", "1e-4", "Added to the variances of every motion [m², rad²].")]
RangeStd = Annotated[float | None, _noise("range-std", "0", "Noise of the range [m]; alone it replaces --range-rate.")]
SensorOffset = Annotated[
    str | None,
    typer.Option(
        metavar="AHEAD,LEFT",
        help=r"Where the sensor sits on the robot \[m].",
        show_default="0,0",
        rich_help_panel=NOISE,
    ),
]
RangeRate = Annotated[float | None, _noise("range-rate", "0.14", "Noise of the range, per metre of it.")]
BearingStd = Annotated[float | None, _noise("bearing-std", "0.05", "Noise of the bearing [rad].")]
OrientationStd = Annotated[float | None, _noise("orientation-std", "0.05", "Noise of psi [rad].")]
