"""Taichi kernels of tisfm, installed as ``tisfm.kernels``.

Every kernel is reached through the function that wraps it: the wrapper checks dtype, shape and
writability, because a kernel that writes outside an array corrupts memory silently.
"""

import os

if __name__ != "tisfm.kernels":
    raise ImportError(
        f"this package was imported as {__name__!r}: install the project (pip install -e .) and "
        "import it as tisfm.kernels"
    )

# Read by Taichi while it is imported: no banner, and no network thread asking for a new version.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
