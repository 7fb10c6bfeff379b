"""pycolmap, imported when it is first needed, and silent."""

from functools import cache
from typing import Any


@cache
def pycolmap() -> Any:
    """Return the module; from then on only its fatal errors are on standard error."""
    import pycolmap as module

    log = module.logging
    log.minloglevel = log.FATAL.value
    return module
