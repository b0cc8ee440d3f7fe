"""The option ``--config``: options beat the configuration file, which beats the defaults.

The values of the file become the defaults of the verb's options before these are read, so whatever is given on the
command line wins, and whatever the file says is checked as if it had been given there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .support import sentences

_META = "comparisons.config"


def _read(ctx: typer.Context, path: Path | None) -> Path | None:
    if path is None or ctx.resilient_parsing:
        return path
    with sentences():
        from ..config import read_config

        flat = read_config(path)
        ctx.meta[_META] = flat
        names = flat.get("estimators")
        # the options of the noise models have no table in front: --nn, not --motion.nn
        options = {key.rsplit(".", 1)[-1]: value for key, value in flat.items()}
        if "offset" in options:
            options["sensor_offset"] = ",".join(map(str, options.pop("offset")))
        ctx.default_map = options | ({"estimators": ",".join(names)} if names else {})
    return path


ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="A TOML file of options, such as the config.toml saved with every run; options given here beat it.",
        show_default=False,
        callback=_read,
        is_eager=True,
    ),
]


def config_of(ctx: typer.Context, config: Path | None, log: Path | None) -> dict[str, Any]:
    """What the configuration file says, flat; empty where none was given.

    Args:
        ctx: of the verb.
        config: the file.
        log: the log that is going to be read; None for the sample log.

    Raises:
        OptionError: it is the file's log, and has changed since the configuration was saved.
    """
    flat: dict[str, Any] = {} if config is None else ctx.meta[_META]
    if "log_sha256" in flat and log == flat.get("log"):
        from graphslam import sample_log_path
        from graphslam.files import check_file

        from ..config import check_unchanged

        path = sample_log_path() if log is None else log
        if not path.is_dir():
            check_file(path)
        check_unchanged(path, flat["log_sha256"])
    return flat


def noise_options(ctx: typer.Context, **options: Any) -> dict[str, Any]:
    """The options of the noise models; those of the configuration are None where ``--noise`` was given beside it.

    Else the models that every saved configuration has would beat, unseen, the file that the user names.
    """

    def typed(name: str) -> bool:
        source = ctx.get_parameter_source(name)
        return source is not None and source.name == "COMMANDLINE"

    if not typed("noise"):
        return options
    return {name: value if typed(name) else None for name, value in options.items()}
