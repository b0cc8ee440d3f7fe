"""``python -m comparisons`` is ``slam-compare``."""

import sys


def main() -> None:
    """Entry point of ``slam-compare``: Ctrl-C ends it with one word and exit status 130, also while it is imported."""
    try:
        from .cli import main as command_line

        command_line()
    except KeyboardInterrupt:
        # before a verb began; the verbs have their own handler
        sys.stderr.write("interrupted\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
