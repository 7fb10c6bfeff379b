"""Taichi kernels of tisfm, installed as ``tisfm.kernels``.

Call kernels only through their wrapper functions. A wrapper checks dtype, shape and writability,
because a kernel that writes outside an array corrupts memory without an error.
"""

import os

if __name__ != "tisfm.kernels":
    raise ImportError(
        f"this package was imported as {__name__!r}: install the project (pip install -e .) and "
        "import it as tisfm.kernels"
    )

# Taichi reads these during its import: no banner, and no network thread that checks for updates.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
