"""The compiled engine, or one sentence where it is missing."""

from importlib import import_module
from typing import Any

from .errors import SlamError

try:
    engine: Any = import_module(f"{__package__}._engine")
except ImportError as error:
    raise SlamError(
        f"the compiled module graphslam._engine cannot be loaded ({error}); build it with: pip install --editable ."
    ) from error
