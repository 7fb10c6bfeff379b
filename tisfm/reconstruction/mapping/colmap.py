"""pycolmap, imported at its first use, with silenced messages."""

from functools import cache
from typing import Any


@cache
def pycolmap() -> Any:
    """Return the module; it writes only fatal errors to standard error."""
    import pycolmap as module

    log = module.logging
    log.minloglevel = log.FATAL.value
    return module
