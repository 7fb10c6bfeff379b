"""Videos, decoded one frame after the other: by PyAV where it is installed, by OpenCV elsewhere.

Both decode by FFmpeg, apply the rotation that a camera wrote into the file, and give the same
pixels and, within a millisecond, the same times. PyAV also says which frames are damaged, and goes
on after frames that cannot be decoded. OpenCV hands damaged frames on unmarked, and stops at those
that it cannot decode.
"""

from importlib.metadata import PackageNotFoundError, version

from tisfm.sources.opencv_video import OpenCvVideo
from tisfm.sources.reading import Reader

AV_FROM = 17  # the first version of PyAV


def open_video(path: str) -> Reader:
    """Open a video.

    Parameters
    ----------
    path : str
        Its file.

    Returns
    -------
    Reader

    Raises
    ------
    ValueError
        If it is no video that can be decoded.
    """
    if has_av():
        from tisfm.sources.av_video import AvVideo

        try:
            return AvVideo(path)
        except ValueError:  # OpenCV knows some that FFmpeg does not, and else says the same
            pass
    return OpenCvVideo(path)


def has_av() -> bool:
    """Return whether PyAV is installed, in a version that gives the same pixels as OpenCV."""
    try:
        return int(version("av").partition(".")[0]) >= AV_FROM
    except (PackageNotFoundError, ValueError):
        return False
