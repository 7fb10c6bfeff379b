"""What the tests of files share: pictures, and files of them."""

import io
import os
from pathlib import Path

import cv2
import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

# The folder of a test is shared by the examples of one property: each overwrites the last.
PROPERTY = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
# Subnormal numbers are left out: a library loaded beside us may have switched them off.
FINITE_OR_NOT = st.floats(width=32, allow_subnormal=False)
SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9)


def contents(folder: Path) -> set[str]:
    """Names of everything in a folder, hidden files included."""
    return set(os.listdir(folder))


def smooth(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Make a picture with something to compress in it."""
    noise = np.random.default_rng(3).random(shape, np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return (blurred * np.iinfo(dtype).max).astype(dtype)


def encoded(suffix: str, image: np.ndarray, **options) -> bytes:
    """Encode with OpenCV, or with Pillow where options say how."""
    if options:
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, **options)
        return buffer.getvalue()
    done, data = cv2.imencode(suffix, image[..., ::-1] if image.ndim == 3 else image)
    assert done
    return data.tobytes()


GREY8, GREY16 = smooth((21, 34), np.uint8), smooth((21, 34), np.uint16)
COLOUR8, COLOUR16 = smooth((21, 34, 3), np.uint8), smooth((21, 34, 3), np.uint16)
FLOAT = GREY16.astype(np.float32) / 7
FILES = {
    "png-grey8": (encoded(".png", GREY8), GREY8),
    "png-grey16": (encoded(".png", GREY16), GREY16),
    "png-colour8": (encoded(".png", COLOUR8), COLOUR8),
    "png-colour16": (encoded(".png", COLOUR16), COLOUR16),
    "pgm-8": (encoded(".pgm", GREY8), GREY8),
    "pgm-16": (encoded(".pgm", GREY16), GREY16),
    "ppm": (encoded(".ppm", COLOUR8), COLOUR8),
    "bmp-grey": (encoded(".bmp", GREY8), GREY8),
    "bmp-colour": (encoded(".bmp", COLOUR8), COLOUR8),
    "tiff-grey8": (encoded(".tiff", GREY8), GREY8),
    "tiff-grey16": (encoded(".tiff", GREY16), GREY16),
    "tiff-colour16": (encoded(".tiff", COLOUR16), COLOUR16),
    "tiff-float": (encoded(".tiff", FLOAT), FLOAT),
    "tiff-float-colour": (encoded(".tiff", np.dstack([FLOAT] * 3)), np.dstack([FLOAT] * 3)),
    "tiff-plain": (encoded("", COLOUR8, format="TIFF"), COLOUR8),
    "tiff-deflate": (encoded("", GREY16, format="TIFF", compression="tiff_deflate"), GREY16),
    "jpeg-grey": (encoded(".jpg", GREY8), None),
    "jpeg-colour": (encoded(".jpg", COLOUR8), None),
    "jpeg-progressive": (encoded("", COLOUR8, format="JPEG", progressive=True), None),
    "webp": (encoded("", COLOUR8, format="WEBP"), None),
}
