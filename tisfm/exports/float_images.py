"""Images of float32: EXR, TIFF and PFM."""

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.errors import MissingPackageError
from tisfm.formats import atomic_write
from tisfm.formats.atomic import TEMPORARY_PREFIX, TEMPORARY_SUFFIX

_DEFLATE = 8  # code of the compression in TIFF


def check_exr() -> None:
    """Raise ImportError unless EXR files can be written."""
    try:
        import OpenEXR  # noqa: F401
    except ImportError as error:
        raise MissingPackageError(
            "EXR files need the package OpenEXR: pip install 'tisfm[export]'; or take TIFF"
        ) from error


def write_exr(
    path: str | os.PathLike[str],
    # mapping of str to (H, W) float32: channels by name, such as Z, or R, G and B
    channels: Mapping[str, NDArray[np.float32]],
) -> None:
    """Write channels of float32 as a scan-line EXR file, without loss, whole or not at all.

    Raises ImportError if OpenEXR is not installed.

    Raises OSError if the file cannot be written.
    """
    check_exr()
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    arrays = {name: np.ascontiguousarray(values, "<f4") for name, values in channels.items()}
    parent = Path(path).absolute().parent
    # OpenEXR only takes file names, and raises RuntimeError if writing fails.
    with tempfile.TemporaryDirectory(
        prefix=TEMPORARY_PREFIX, suffix=TEMPORARY_SUFFIX, dir=parent
    ) as folder:
        file = Path(folder, "picture.exr")
        try:
            OpenEXR.File(header, arrays).write(str(file))
        except RuntimeError as error:
            raise OSError(f"cannot write {path}: {error}") from error
        content = file.read_bytes()
    with atomic_write(path) as stream:
        stream.write(content)


def write_tiff(
    path: str | os.PathLike[str],
    values: NDArray[np.float32],  # (H, W) or (H, W, 3) float32: three channels are red, green, blue
) -> None:
    """Write float32 as TIFF, deflated, whole or not at all.

    Raises OSError if the file cannot be written.
    """
    _write(path, ".tiff", values, [cv2.IMWRITE_TIFF_COMPRESSION, _DEFLATE])


def write_pfm(path: str | os.PathLike[str], values: NDArray[np.float32]) -> None:
    """Write (H, W) float32 as PFM, rows from the bottom, little-endian, whole or not at all.

    Raises OSError if the file cannot be written.
    """
    _write(path, ".pfm", values, [])


def _write(
    path: str | os.PathLike[str], suffix: str, values: NDArray[np.float32], options: list[int]
) -> None:
    picture = np.ascontiguousarray(values[..., ::-1] if values.ndim == 3 else values)
    _, content = cv2.imencode(suffix, picture, options)
    with atomic_write(path) as stream:
        stream.write(content.data)
