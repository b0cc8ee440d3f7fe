"""``python -m comparisons`` is ``slam-compare``."""

import os
import signal
import sys
from contextlib import suppress
from types import FrameType
from typing import NoReturn


def main() -> None:
    """Entry point of ``slam-compare``: Ctrl-C ends it with one word and exit status 130, also while it is imported.

    Letters that the encoding of the output lacks become question marks, and an output that cannot be written is one sentence.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # it is not ignored, as in the background of a shell
        signal.signal(signal.SIGINT, _leave)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    status: object = 1
    try:
        from .cli import main as command_line

        command_line()
    except SystemExit as end:
        status = end.code
    except KeyboardInterrupt:
        # before a verb began; the verbs have their own handler
        sys.stderr.write("interrupted\n")
        status = 130
    except ImportError as error:
        if error.name != "graphslam._engine":
            raise
        sys.stderr.write(f"error: {error}\n")
        status = 2
    except OSError as error:
        # a help, or an error that could not be shown
        _cannot_write(error, status)
    _flush(status)
    sys.exit(status)  # type: ignore[arg-type]


def _leave(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
    """End while modules are imported: an exception in the middle of one may be swallowed, or printed, by others."""
    os.write(2, b"interrupted\n")
    os._exit(130)


def _flush(status: object) -> None:
    """Write the buffered output; where that fails, end here, because Python would try again and print a traceback."""
    try:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
    except OSError as error:
        _cannot_write(error, status)


def _cannot_write(error: OSError, status: object) -> NoReturn:
    if isinstance(error, BrokenPipeError):
        # the reader of the output has closed the pipe
        os._exit(status if isinstance(status, int) else 1)
    with suppress(OSError):
        os.write(2, f"error: the output cannot be written: {error.strerror}\n".encode())
    os._exit(2)


if __name__ == "__main__":
    main()
