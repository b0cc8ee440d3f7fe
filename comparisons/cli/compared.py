"""What the verbs ``run`` and ``report`` do before they part: read the log, run the estimators as the options say."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from .config_file import config_of, noise_options
from .support import Advance, Output, models, read_log, with_noise

if TYPE_CHECKING:
    from ..comparison import Comparison, Progress, Skipped
    from ..config import RunConfig
    from ..estimator import EstimatorResult

_READING = ("robot", "keep_every", "stride", "max_range")
_NOISE = ("nn", "no", "on", "oo", "sigma_v", "sigma_omega", "epsilon", "range_rate", "range_std", "bearing_std",
          "orientation_std", "sensor_offset", "range_scale", "range_bias")  # fmt: skip


def compared(
    ctx: typer.Context,
    output: Output,
    *,
    log: Path | None,
    config: Path | None,
    estimators: str | None,
    format: str | None,
    dimensions: int | None,
    noise: Path | None,
    **told: Any,
) -> tuple[Comparison, RunConfig]:
    """The comparison that the options of ``run`` ask for, and its effective configuration.

    Args:
        ctx: of the verb.
        output: where progress is shown.
        log: None for the sample log.
        config: the file of ``--config``, already read.
        estimators: 'a,b,...'; None for all.
        format, dimensions: of the log.
        noise: the file of ``--noise``.
        told: the other options of ``run``, by the names of its parameters.

    Raises:
        SlamError: the log, an option, or a named estimator is at fault.
    """
    from ..comparison import compare, with_models
    from ..config import RunConfig, sha256_of
    from ..estimator import RunOptions
    from ..estimators import ESTIMATORS

    config_of(ctx, config, log)
    reading = {name: told.pop(name) for name in _READING}
    data, source = read_log(log, format, dimensions, **reading)
    said = noise_options(ctx, **{name: told.pop(name) for name in _NOISE})
    data, line = with_noise(data, noise, said.pop("range_scale"), said.pop("range_bias"))
    reading |= line
    motion, sensor = models(data, **said)
    options = RunOptions(motion=motion, sensor=sensor, **told)
    names = None if estimators is None else [name.strip() for name in estimators.split(",") if name.strip()]
    # the whole path, so that a repeat from another folder writes the same
    source = source.absolute()
    effective = RunConfig(
        log=None if log is None else source, log_sha256=sha256_of(source), format=format, dimensions=dimensions,
        estimators=None if names is None else tuple(names), options=with_models(options, data), **reading,
    )  # fmt: skip
    with output.bar("estimators", len(names or ESTIMATORS)) as advance:
        return compare(data, names, options, source=source, progress=_progress(output, advance)), effective


def _progress(output: Output, advance: Advance) -> Progress:
    def report(name: str, outcome: EstimatorResult | Skipped | None) -> None:
        from ..estimator import EstimatorResult
        from ..tables import seconds

        if outcome is None:
            advance(0, name)
            return
        advance(1, name)
        if isinstance(outcome, EstimatorResult):
            output.detail(f"{name}: {seconds(outcome.seconds)}" + (f", {outcome.reason}" if outcome.reason else ""))

    return report
