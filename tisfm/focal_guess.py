"""Guess the focal length of frames from an unknown camera."""

import io
import math
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from PIL import ExifTags, Image

from tisfm.camera import Camera
from tisfm.errors import InputError, InputTypeError

__all__ = ["FocalGuess", "GuessedFocalWarning", "guess_camera", "guess_focal"]

# Focal length divided by the longer side: a view of 45°, between phones and other cameras.
DEFAULT_FOCAL_RATIO = 1.2
FILM_DIAGONAL = math.hypot(36, 24)  # mm
# Focal length divided by the longer side: EXIF data outside this range are wrong.
FOCAL_RATIO_RANGE = (0.1, 100)
_SIDEWAYS_ORIENTATIONS = (5, 6, 7, 8)  # orientations in EXIF data that exchange height and width
# mm, by the code of the unit of resolution in EXIF data: inch, cm, mm and µm
_UNIT_LENGTHS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}


class GuessedFocalWarning(UserWarning):
    """The focal length is a guess, or the motion hardly determines it; results depend on it."""


@dataclass(frozen=True, kw_only=True)
class FocalGuess:
    """A guessed focal length.

    Attributes
    ----------
    focal : float
        px.
    origin : {"exif", "size"}
        Source of the guess: the EXIF data of the file, or the size of the image alone.
    reason : str
        How the guess was computed, in words.
    shape : (int, int)
        Height and width of the image, px.

    Examples
    --------
    >>> from tisfm.focal_guess import FocalGuess, guess_focal
    >>> isinstance(guess_focal("frame0.png"), FocalGuess)
    True
    """

    focal: float
    origin: Literal["exif", "size"]
    reason: str
    shape: tuple[int, int]


def guess_focal(source: str | os.PathLike[str] | Sequence[int]) -> FocalGuess:
    """Guess the focal length of an image.

    The EXIF data of a file are used first: the 35 mm equivalent focal length, for which the
    diagonal of the film equals the diagonal of the image, or else the true focal length together
    with the resolution of the sensor. If the EXIF data state a larger image, the image is assumed
    to have been resized. If they state another aspect ratio, it is assumed to have been cropped
    along one axis. Without usable EXIF data the guess is 1.2 times the longer side.

    Parameters
    ----------
    source : path or (H, W) or (H, W, 3)
        An image file, or the shape of a frame.

    Returns
    -------
    FocalGuess

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError
        If the file does not exist or cannot be read.
    tisfm.formats.FormatError
        A ValueError: if the file is not an image.
    TypeError, ValueError
        If `source` is neither a path nor a shape.

    Examples
    --------
    >>> from tisfm.focal_guess import guess_focal
    >>> guess = guess_focal((480, 640))  # or the path of a picture with EXIF data
    >>> guess.focal, guess.origin
    (768.0, 'size')
    """
    if isinstance(source, (str, os.PathLike)):
        size, exif = _read_size_and_exif(source)
        return _guess_from_exif(size, exif) or _guess_from_size(size)
    return _guess_from_size(_check_size(source))


def guess_camera(source: str | os.PathLike[str] | Sequence[int]) -> Camera:
    """Return a camera with a guessed focal length and the centre of the image; warn about it.

    Parameters
    ----------
    source
        As for `guess_focal`.

    Returns
    -------
    Camera

    Warns
    -----
    GuessedFocalWarning
        Always. The text has the guess, its source, and what to do.

    Raises
    ------
    OSError, TypeError, ValueError
        As `guess_focal`.

    Examples
    --------
    >>> import warnings
    >>> from tisfm.focal_guess import GuessedFocalWarning, guess_camera
    >>> with warnings.catch_warnings(record=True) as caught_warnings:
    ...     warnings.simplefilter("always")
    ...     camera = guess_camera("frame0.png")
    >>> camera.focal, caught_warnings[0].category is GuessedFocalWarning
    (76.8, True)
    """
    guess = guess_focal(source)
    warnings.warn(
        f"the focal length is a guess, {guess.focal:.0f} px{at_size(guess.shape)}, "
        f"{guess.reason}: give a "
        "tisfm.Camera(focal=…) if you know it, for instance from a calibration",
        GuessedFocalWarning,
        stacklevel=2,
    )
    return Camera(focal=guess.focal)


def at_size(shape: tuple[int, int] | None) -> str:
    """Return the frame size (H, W) as text to put after a length in px; "" if it is unknown.

    Examples
    --------
    >>> from tisfm.focal_guess import at_size
    >>> f"910 px{at_size((720, 1280))}"
    '910 px (at 1280×720)'
    """
    return "" if shape is None else f" (at {shape[1]}×{shape[0]})"


def _guess_from_size(size: tuple[int, int]) -> FocalGuess:
    return FocalGuess(
        focal=DEFAULT_FOCAL_RATIO * max(size),
        origin="size",
        reason=f"{DEFAULT_FOCAL_RATIO:g} times the longer side, without usable EXIF data",
        shape=size,
    )


def _guess_from_exif(size: tuple[int, int], exif: Mapping[int, Any]) -> FocalGuess | None:
    """Return the guess from the EXIF data of an image of this size (H, W), or None."""
    width, height = (
        _positive_entry(exif, tag)
        for tag in (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight)
    )
    original_size = (height, width) if height and width else size
    # Compare the longer with the longer side: the image may have been turned upright.
    scale = max(pick(size) / pick(original_size) for pick in (max, min))
    film_focal = _positive_entry(exif, ExifTags.Base.FocalLengthIn35mmFilm)
    if film_focal:
        focal = film_focal / FILM_DIAGONAL * math.hypot(*original_size) * scale
        if _is_plausible(focal, size):
            reason = f"from the image's EXIF data ({film_focal:g} mm in terms of 35 mm film)"
            return FocalGuess(focal=focal, origin="exif", reason=reason, shape=size)
    true_focal = _positive_entry(exif, ExifTags.Base.FocalLength)
    resolution = _positive_entry(exif, ExifTags.Base.FocalPlaneXResolution)
    unit_length = _UNIT_LENGTHS.get(exif.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))
    if true_focal and resolution and unit_length:
        density = resolution / unit_length
        focal = true_focal * density * scale
        if _is_plausible(focal, size):
            reason = f"from the image's EXIF data ({true_focal:g} mm, {density:.4g} px/mm)"
            return FocalGuess(focal=focal, origin="exif", reason=reason, shape=size)
    return None


def _is_plausible(focal: float, size: tuple[int, int]) -> bool:
    min_ratio, max_ratio = FOCAL_RATIO_RANGE
    return min_ratio * max(size) <= focal <= max_ratio * max(size)


def _positive_entry(exif: Mapping[int, Any], tag: int) -> float | None:
    """Return a positive finite number of the EXIF data, or None: 0 means unknown."""
    try:
        value = float(exif[tag])
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return None
    return value if 0 < value < math.inf else None


def _read_size_and_exif(path: str | os.PathLike[str]) -> tuple[tuple[int, int], Mapping[int, Any]]:
    """Return the size (H, W) of an image file and its EXIF data."""
    from tisfm.formats.image_headers import PILLOW_FORMATS
    from tisfm.formats.images import read_image
    from tisfm.formats.reading import read_bytes

    data = read_bytes(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damaged EXIF data and large pictures
            with Image.open(io.BytesIO(data), formats=PILLOW_FORMATS) as picture:
                return _upright_size(picture), _read_exif(picture)
    except MemoryError:
        raise
    except Exception:  # Pillow cannot read the format or the size, but OpenCV may
        height, width = read_image(path).shape[:2]
        return (height, width), {}


def _upright_size(picture: Image.Image) -> tuple[int, int]:
    """Return height and width of the picture once it is turned as its EXIF data say."""
    try:
        is_turned = picture.getexif().get(ExifTags.Base.Orientation) in _SIDEWAYS_ORIENTATIONS
    except MemoryError:
        raise
    except Exception:  # Pillow raises many kinds for damaged EXIF data
        is_turned = False
    height, width = picture.height, picture.width
    return (width, height) if is_turned else (height, width)


def _read_exif(picture: Image.Image) -> Mapping[int, Any]:
    try:
        return dict(picture.getexif().get_ifd(ExifTags.IFD.Exif))
    except MemoryError:
        raise
    except Exception:  # Pillow raises many kinds for damaged EXIF data: the picture is still good
        return {}


def _check_size(shape: Sequence[int]) -> tuple[int, int]:
    try:
        height, width, *_ = (int(side) for side in shape)
    except TypeError:
        raise InputTypeError(
            f"source is {shape!r}: expected the path of an image, or the shape (H, W) of a frame"
        ) from None
    except ValueError:
        height = width = 0
    if height < 1 or width < 1:
        raise InputError(f"source is {shape!r}: expected a shape (H, W) or (H, W, 3)")
    return height, width
