"""One case: how it is run, and what counts as wrong."""

from __future__ import annotations

import signal
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

from graphslam import SlamError

#: the name of a case, and a function that returns what is wrong
Case = tuple[str, Callable[[], list[str]]]
#: the longest run of letters without a space in a message: an input of at most 80, or a path
LONGEST_WORD = 110


class TooLong(BaseException):
    """A case has reached its limit of processor time, or waits for something that does not come."""


def attempt(check: Callable[[], list[str]], limit: int = 20) -> tuple[str, list[str]]:
    """ "solved" or "refused", and what is wrong: problems that the check returned, an exception, or no end.

    Args:
        check: the case.
        limit: of its processor time [s]; it may take ten times as long by the clock.
    """
    interrupted = False

    def too_long(*_: object) -> None:
        nonlocal interrupted
        interrupted = True
        raise TooLong

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        before = [signal.signal(each, too_long) for each in (signal.SIGPROF, signal.SIGALRM)]
        signal.setitimer(signal.ITIMER_PROF, limit)
        signal.alarm(10 * limit)
        try:
            return "solved", check()
        except TooLong:
            return "too long", [f"no end within {limit} s of processor time"]
        except SlamError as error:
            if interrupted:
                # a factor of GTSAM turns everything that interrupts it into an error
                return "too long", [f"no end within {limit} s of processor time"]
            return "refused", wrong_with_message(str(error))
        except Exception as error:
            frames = [f for f in traceback.extract_tb(error.__traceback__) if "site-packages" not in f.filename]
            where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}"
            return "failed", [f"{type(error).__name__} in {where}: {error}"]
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.alarm(0)
            for each, handler in zip((signal.SIGPROF, signal.SIGALRM), before):
                signal.signal(each, handler)


def wrong_with_message(text: str) -> list[str]:
    """What is wrong with the message of a refusal: it is one line and does not repeat long inputs."""
    if "\n" in text.strip() or not text.strip():
        return [f"an error of several lines, or of none: {text}"]
    if (longest := max(map(len, text.split()))) > LONGEST_WORD:
        return [f"a word of {longest} letters in the message: {text[:200]}"]
    return []
