"""Videos, decoded one frame after the other: by PyAV where it is installed, by OpenCV elsewhere.

Both decode by FFmpeg, apply the rotation that a camera wrote into the file, resample frames to
square pixels, and give the same pixels and, within a millisecond, the same times. PyAV also says
which frames are damaged, and goes on after frames that cannot be decoded. OpenCV hands damaged
frames on unmarked, and stops at those that it cannot decode. Of several video streams PyAV reads
the one that is marked as default, or else the largest; OpenCV reads the first.
"""

from importlib.metadata import PackageNotFoundError, version

from tisfm.formats import FormatError
from tisfm.formats.reading import open_file
from tisfm.sources.containers import why_without_frames
from tisfm.sources.opencv_video import OpenCvVideo
from tisfm.sources.reading import Reader

# Beginnings of files that only name others, which FFmpeg would open wherever they are: lists of
# HLS, of its own and in XML, and tags before them.
_LISTS = (b"#EXTM3U", b"ffconcat", b"<?xml", b"<MPD", b"ID3")
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
        If it is no video that can be decoded, or names other files to be read.
    OSError
        If it cannot be read.
    """
    with open_file(path) as file:
        beginning = file.read(max(map(len, _LISTS)))
    if beginning.startswith(_LISTS):
        raise FormatError(f"{path} is a list of other files, no video: give one of those")
    if not beginning:
        raise FormatError(f"{path} is empty (0 bytes): copy or record it again")
    if reason := why_without_frames(path):
        raise FormatError(
            f"{path} cannot be read: {reason}; copy it again, record it again, or rebuild its "
            "table with a tool for that, such as untrunc"
        )
    if has_av():
        from tisfm.sources.av_video import AvVideo

        try:
            return AvVideo(path)
        except FormatError:
            raise
        except ValueError:  # OpenCV knows some that FFmpeg does not, and else says the same
            pass
    return OpenCvVideo(path)


def has_av() -> bool:
    """Return whether PyAV is installed, in a version that gives the same pixels as OpenCV."""
    try:
        return int(version("av").partition(".")[0]) >= AV_FROM
    except (PackageNotFoundError, ValueError):
        return False
