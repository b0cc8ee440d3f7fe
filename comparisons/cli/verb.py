"""A verb of ``slam-compare`` from a function and the dataclasses of its options.

A parameter of the function that is annotated with a dataclass of `comparisons.options` becomes all the options of that
dataclass; the function receives the dataclass, checked. ``output`` is the verb's `Output`. Other parameters are arguments of
typer. Every verb has --json, --quiet, --verbose and --lang; a verb that reads a log has --config, too.
"""

from __future__ import annotations

import inspect
import shlex
import signal
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from .output import Output, in_language, sentences

if TYPE_CHECKING:
    from typer.core import TyperCommand

    from ..options import Option, Options


def argument(metavar: str, help: str, default: str | bool = False) -> Any:
    """An argument of a verb: its name in the usage, its help, and in words what stands for it where it is missing."""
    return typer.Argument(metavar=metavar, help=help, show_default=default)


#: the argument LOG of most verbs
LogFile = Annotated[
    Path | None, argument("LOG", "The log: a file, or the folder of a data set.", "the sample log of the package")
]
_META = "comparisons.estimators.config"


def add_verb(app: typer.Typer, function: Callable[..., None], kind: type[TyperCommand], language: str = "en") -> None:
    """Add a function as a verb of its name to the command line; its docstring is the help, with "Examples:" at its end.

    Args:
        app: the command line.
        function: the verb.
        kind: the class of its command.
        language: of its help.
    """
    from .. import options as declared

    # the modules of the verbs do not import the options, so that the list of all verbs is shown at once
    hints = get_type_hints(function, localns={"declared": declared}, include_extras=True)
    parameters = [p for p in inspect.signature(function).parameters.values() if p.name != "output"]
    groups = {p.name: hints[p.name] for p in parameters if isinstance(hints[p.name], type)}
    groups = {name: kind for name, kind in groups.items() if issubclass(kind, declared.Options)}
    options: dict[str, Option] = {}
    for group in (*groups.values(), declared.JsonOptions):
        options |= {name: each for name, each in declared.options_of(group).items() if each.only != "python"}
    arguments = [p.replace(annotation=hints[p.name]) for p in parameters if p.name not in groups]
    configurable = any(issubclass(group, declared.ReadingOptions) for group in groups.values())

    def command(
        ctx: typer.Context, quiet: bool, verbose: bool, lang: str | None, config: Path | None = None, **values: Any
    ) -> None:
        # of the command line, where the verb has none of its own
        lang = lang or ctx.obj
        with sentences(verbose, options, lang):
            values = _without_outranked(ctx, values, options)
            if config is not None:
                values = _with_logs(ctx, values)
            output = Output(values.pop("json"), quiet=quiet, verbose=verbose, lang=lang, options=options)
            for name, group in groups.items():
                values[name] = group.of(**{o: values.pop(o) for o in declared.options_of(group) if o in values})
                _check_places(values[name])
            _interruptible()
            function(output=output, **values)

    context = inspect.Parameter("ctx", inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=typer.Context)
    extra = [_CONFIG] if configurable else []
    signature = [context, *arguments, *extra, *(_parameter(each, language) for each in options.values()), *_VERBOSITY]
    signature = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in signature]
    command.__signature__ = inspect.Signature(signature)  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in signature}
    command.__doc__, examples = _help_of(function, language)
    app.command(name_of(function), cls=kind, epilog=epilog_of(examples, language))(command)


def _help_of(function: Callable[..., None], language: str) -> tuple[str, list[str]]:
    """The help of a verb in a language, and its examples."""
    text, _, examples = inspect.cleandoc(function.__doc__ or "").partition("Examples:\n")
    paragraphs = (in_language(paragraph, language) for paragraph in text.strip().split("\n\n"))
    return "\n\n".join(paragraphs), examples.splitlines()


def epilog_of(examples: Sequence[str], language: str) -> str:
    """Examples below a help, with blank lines between, because neighbouring lines are joined."""
    return "\n\n".join([in_language("Examples:", language), *(f"  {line.strip()}" for line in examples)])


def _check_places(options: Options) -> None:
    """Raise now rather than after minutes of work if a file that the options name cannot be written."""
    from ..results.files import check_can_write

    for option, value in options.changed():
        if option.writes is not None and value is not None:
            check_can_write(value, endings=option.writes)


def _interruptible() -> None:
    """Make Ctrl-C an exception from here on, so that files are written whole or not at all, unless it is ignored.

    Until then the entry point ends the process at once, because imports may suppress the exception.
    """
    handled = signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, signal.SIG_DFL, None)
    if handled and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)


def name_of(function: Callable[..., None]) -> str:
    """The name of a verb; that of a function may need an underscore at its end, because Python reserves the word."""
    return function.__name__.rstrip("_")


def list_verb(app: typer.Typer, function: Callable[..., None], language: str = "en") -> None:
    """Add a function for the list of verbs only, without its options."""

    def listed() -> None:
        pass

    listed.__doc__, _ = _help_of(function, language)
    app.command(name_of(function))(listed)


def _parameter(option: Option, language: str = "en") -> inspect.Parameter:
    """The option as a parameter that typer understands; its default None stands for the option's own."""
    # several values are one word with commas
    kind: Any = option.each if option.kind in (str, int, float, bool) else str
    off = f"/--no-{option.flag[2:]}" if option.kind is bool and option.default is not False else ""
    # the unit is in the first sentence
    stop, between = (".", ". ") if language == "en" else ("。", "。")
    first, dot, more = in_language(option.help, language).removesuffix(stop).partition(between)
    text = first + (f" [{option.unit}]" if option.unit else "") + f"{dot}{more}{stop}"
    if not all(choice in option.help for choice in option.choices):
        several = "One or several of, with commas between: {}." if option.kind is tuple else "One of: {}."
        text += f" {in_language(several, language).format(', '.join(option.choices))}"
    default: str | bool = option.default not in (None, False)
    if default or option.default_text:
        # spaces, at which the help breaks lines
        default = in_language(option.default_text, language) or option.text(option.default).replace(",", ", ")
    settings = typer.Option(
        option.flag + off, help=text.replace("[", r"\["), metavar=option.metavar or None, show_default=default,
        rich_help_panel=in_language(option.panel, language) or None,
    )  # fmt: skip
    return _keyword(option.name, None, Annotated[kind | None, settings])


def _keyword(name: str, default: Any, annotation: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _flag(name: str, short: str, text: str) -> inspect.Parameter:
    return _keyword(name, False, Annotated[bool, typer.Option(f"--{name}", short, help=text)])


#: the language, before the verb or among its options
Lang = Annotated[str | None, typer.Option(
    "--lang", metavar="en|ja", show_default="that of LC_ALL or LANG, else en",
    help="Language of tables, figures, messages, reports and this help. What has no translation appears in English.",
)]  # fmt: skip
_VERBOSITY = [
    _flag("quiet", "-q", "Results only: no progress, no hints."),
    _flag("verbose", "-v", "Also report each step of the work, and the traceback of an error."),
    _keyword("lang", None, Lang),
]


def _read_config(ctx: typer.Context, path: Path | None) -> Path | None:
    """Make the values of a configuration file the defaults of the options, so that the command line takes precedence."""
    if path is not None and not ctx.resilient_parsing:
        with sentences(verbose=False, lang=ctx.obj):
            from ..estimators.config import read_config

            values = read_config(path)
        ctx.meta[_META] = values
        ctx.default_map = {
            # the other logs are several words
            name: ",".join(map(str, value)) if isinstance(value, (list, tuple)) and name != "others" else value
            for name, value in values.items()
        }
    return path


_CONFIG = _keyword("config", None, Annotated[Path | None, typer.Option(
    "--config", metavar="FILE", show_default=False, callback=_read_config, is_eager=True,
    help="A TOML file of options, such as the config.toml of an earlier run. Options of the command line take precedence.",
)])  # fmt: skip


def _with_logs(ctx: typer.Context, values: dict[str, Any]) -> dict[str, Any]:
    """The values with the logs of the configuration, unless the command line names one.

    Raises:
        OptionError: the logs have changed since the configuration was saved, or the verb takes fewer.
    """
    found = ctx.meta[_META]
    of_config = [found.get("log"), *found.get("others", ())]
    if "words" in values:
        # the words [LOG] OUT
        named = len(values["words"]) > 1
        if not named and "log" in found:
            values |= {"words": [str(found["log"]), *values["words"]]}
        logs = [Path(values["words"][0])] if named else of_config[:1]
    else:
        named = _typed(ctx, "log")
        if named and "others" in values and not _typed(ctx, "others"):
            values |= {"others": None}
        logs = [values.get("log"), *(values.get("others") or ())]
    if not named and len(logs) < len(of_config):
        from graphslam.errors import OptionError

        raise OptionError(f"the configuration is of {len(of_config)} logs, and {ctx.info_name} takes one: name it")
    if "log_sha256" in found and logs == of_config:
        from ..estimators.config import check_unchanged

        check_unchanged(logs, found["log_sha256"])
    return values


def _typed(ctx: typer.Context, name: str) -> bool:
    """Whether a value comes from the command line."""
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _without_outranked(ctx: typer.Context, values: dict[str, Any], options: dict[str, Option]) -> dict[str, Any]:
    """The values without the noise numbers of a configuration file where --noise names another file.

    Where the sensor is and what it can see is no noise.
    """
    if not ("noise" in options and _typed(ctx, "noise")):
        return values
    from ..options import NoiseOptions, SensorModel, options_of

    every = options_of(NoiseOptions).items()
    of_noise = {name for name, each in every if each.only != "python" and each.field not in SensorModel.GEOMETRY}
    return {name: value if name not in of_noise or _typed(ctx, name) else None for name, value in values.items()}


def places(words: list[str], form: str) -> tuple[Path | None, Path]:
    """The first of two places, or None, and the last, of words such as '[LOG] OUT'.

    Raises:
        OptionError: there are more words; the message shows the form.
    """
    from graphslam.errors import OptionError

    if len(words) > 2:
        raise OptionError(f"give at most {form}")
    return (Path(words[0]) if len(words) == 2 else None), Path(words[-1])


def command(
    verb: str, *words: Path | str | None, options: Options | Sequence[Options] = (), leave_out: Sequence[str] = ()
) -> str:
    """A command line that can be pasted: the verb, the words that are not None, and all options off their defaults.

    Args:
        verb: of ``slam-compare``.
        words: arguments of the verb.
        options: those of the run that the command continues, one dataclass or several.
        leave_out: names of options that the verb does not have.
    """
    parts = [str(word) for word in words if word is not None]
    groups = options if isinstance(options, Sequence) else [options]
    for option, value in (each for group in groups for each in group.changed()):
        if option.only == "python" or option.name in leave_out:
            continue
        if option.kind is bool:
            parts.append(option.flag if value else f"--no-{option.flag[2:]}")
        else:
            parts += [option.flag, option.text(value)]
    return f"slam-compare {shlex.join([verb, *parts])}"
