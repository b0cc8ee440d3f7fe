"""The compiled engine, or one sentence where it is missing."""

from .errors import SlamError

try:
    from . import _engine as engine
except ImportError as error:
    raise SlamError(
        f"the compiled module graphslam._engine cannot be loaded ({error}); build it with: pip install --editable ."
    ) from error

__all__ = ["engine"]
