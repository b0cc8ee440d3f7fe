"""``python -m comparisons`` is ``slam-compare``."""

from .cli import main

if __name__ == "__main__":
    main()
