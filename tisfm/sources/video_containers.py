"""The structure of video files, read without a decoder: frame tables and numbers of streams."""

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from tisfm.formats.reading import open_file

# Boxes that an MP4 or QuickTime file may begin with.
_MP4_FIRST_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"pnot")
# First box and brand of HEIC and AVIF images, which have the same structure.
_IMAGE_BRANDS = tuple(b"ftyp" + brand for brand in (b"heic", b"heix", b"mif1", b"avif"))
# Elements of Matroska files, by their ids in the specification.
_EBML = 0x1A45DFA3  # the header
_SEGMENT = 0x18538067  # all streams of the file
_TRACKS = 0x1654AE6B  # descriptions of the streams
_TRACK_ENTRY = 0xAE  # description of one stream
_TRACK_TYPE = 0x83  # video, audio or other
_CLUSTER = 0x1F43B675  # frames; they come after the descriptions of the streams
_VIDEO_TRACK = 1  # value of _TRACK_TYPE
_MAX_BOXES = 100_000  # boxes or elements to read from a file: a damaged file may have no end


def reason_without_frames(path: str) -> str | None:
    """Return why an MP4 or QuickTime file has no readable frames; None if no fault is found.

    Such a file ends with the moov box, the table of its frames, unless it was made for streaming.
    The box is missing if a recording or a copy was interrupted. Return None for all other files,
    and for HEIC and AVIF images.
    """
    end = Path(path).stat().st_size
    with open_file(path) as file:
        if file.read(12)[4:] in _IMAGE_BRANDS:
            return None
        boxes = list(_boxes(file, 0, end))
    if not boxes or boxes[0][0] not in _MP4_FIRST_BOXES:
        return None
    table_ends = [stop for kind, _, stop in boxes if kind == b"moov"]
    if not table_ends:
        return "it has no table of frames (no moov atom), so the recording was not finished"
    if table_ends[0] > end:
        return "its table of frames (the moov atom) is cut off"
    return None


def count_video_streams(path: str) -> int | None:
    """Count the video streams of an MP4, QuickTime or Matroska file; None for other files."""
    end = Path(path).stat().st_size
    with open_file(path) as file:
        first_bytes = file.read(8)
        if first_bytes[:4] == _EBML.to_bytes(4, "big"):
            return _count_matroska_videos(file, end)
        if first_bytes[4:8] in _MP4_FIRST_BOXES:
            return _count_mp4_videos(file, end)
    return None


def _boxes(file: BinaryIO, begin: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield kind, content begin and end of each box of an MP4 file from byte `begin` to `end`."""
    for _ in range(_MAX_BOXES):
        if begin + 8 > end:
            return
        file.seek(begin)
        header = file.read(16)
        size, content_begin = int.from_bytes(header[:4], "big"), begin + 8
        if size == 1:
            size, content_begin = int.from_bytes(header[8:16], "big"), begin + 16
        stop = end if size == 0 else begin + size
        if stop < content_begin:
            return
        yield header[4:8], content_begin, stop
        begin = stop


def _count_mp4_videos(file: BinaryIO, end: int) -> int:
    """Return the number of video tracks of an MP4 file."""
    return sum(
        _handler_type(file, begin, stop) == b"vide"
        for begin, stop in _boxes_by_path(file, 0, end, (b"moov", b"trak", b"mdia", b"hdlr"))
    )


def _boxes_by_path(
    file: BinaryIO, begin: int, end: int, kinds: tuple[bytes, ...]
) -> Iterator[tuple[int, int]]:
    """Yield content begin and end of boxes of the last kind, nested in boxes of earlier kinds."""
    for kind, content_begin, stop in _boxes(file, begin, end):
        if kind != kinds[0] or stop > end:
            continue
        if len(kinds) == 1:
            yield content_begin, stop
        else:
            yield from _boxes_by_path(file, content_begin, stop, kinds[1:])


def _handler_type(file: BinaryIO, begin: int, end: int) -> bytes:
    file.seek(begin + 8)
    return file.read(4) if end - begin >= 12 else b""


def _count_matroska_videos(file: BinaryIO, end: int) -> int:
    """Return the number of video tracks of a Matroska or WebM file."""
    count = 0
    for kind, begin, stop in _elements(file, 0, end):
        if kind != _SEGMENT:
            continue
        for child, child_begin, child_end in _elements(file, begin, stop):
            if child == _CLUSTER:
                return count
            for entry, entry_begin, entry_end in (
                _elements(file, child_begin, child_end) if child == _TRACKS else ()
            ):
                count += entry == _TRACK_ENTRY and _is_video(file, entry_begin, entry_end)
    return count


def _is_video(file: BinaryIO, begin: int, end: int) -> bool:
    """Return whether a track of a Matroska file is a video track."""
    for kind, content_begin, stop in _elements(file, begin, end):
        if kind == _TRACK_TYPE:
            file.seek(content_begin)
            return int.from_bytes(file.read(stop - content_begin), "big") == _VIDEO_TRACK
    return False


def _elements(file: BinaryIO, begin: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield kind, content begin and end of each element of a Matroska file in a byte range."""
    for _ in range(_MAX_BOXES):
        file.seek(begin)
        kind = _read_integer(file, with_marker=True)
        size = _read_integer(file, with_marker=False)
        content_begin = file.tell()
        if kind is None or size is None or content_begin > end:
            return
        value, is_unknown = size
        stop = end if is_unknown else min(end, content_begin + value)
        yield kind[0], content_begin, stop
        begin = stop
        if begin >= end:
            return


def _read_integer(file: BinaryIO, *, with_marker: bool) -> tuple[int, bool] | None:
    """Return a Matroska integer of variable length, and whether all its bits are ones.

    The first bits of the first byte are the marker, which states the length. An id includes the
    marker; a size does not.
    """
    first = file.read(1)
    if not first or not first[0]:
        return None
    length = 9 - first[0].bit_length()
    data = first + file.read(length - 1)
    if len(data) < length:
        return None
    value = int.from_bytes(data, "big")
    bits = value & ((1 << 7 * length) - 1)  # without the marker
    return (value if with_marker else bits), bits == (1 << 7 * length) - 1
