"""Files of a folder or of a glob pattern, in the order of their names; URLs are refused."""

import glob
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

from tisfm.errors import InputError
from tisfm.formats import IMAGE_SUFFIXES
from tisfm.formats.image_names import in_order
from tisfm.formats.images import natural_order

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://?", re.DOTALL)
_WITHOUT_SCHEME = re.compile(r"www\.[^/]+\.[^/]+(/|$)|youtu\.be/")  # as browsers show them
_STREAMS = ("mms", "rtmp", "rtmps", "rtp", "rtsp", "rtsps", "srt", "tcp", "udp", "v4l2")


def refuse_url(source: str) -> None:
    """Raise ValueError if a source is a URL; it says what to give instead."""
    match = _URL.match(source)
    is_without_scheme = _WITHOUT_SCHEME.match(source) and not os.path.exists(source.split("/")[0])
    if match is None and not is_without_scheme:
        return
    scheme = match[1].lower() if match else "https"
    if scheme == "file":
        path = _path_of(source)
        instead = f"give the path, {path}" if path else "give the path of the file"
    elif scheme in _STREAMS:
        instead = (
            "record a part of it to a file first, for instance by "
            f"`ffmpeg -i {source} -t 60 -c copy film.mkv`, and give that"
        )
    else:
        instead = "download the file, and give its path"
    raise InputError(f"{source} is a URL, and only files are read: {instead}")


def _path_of(url: str) -> str:
    """Return the path that a file:// URL stands for, "" if it is of another machine."""
    try:
        parts = urlsplit(url)
    except ValueError:
        return ""
    return url2pathname(parts.path) if parts.netloc in ("", "localhost") else ""


# Suffixes of pictures that cannot be read, and of pictures that only a pattern finds: folders are
# not searched for them.
_UNREADABLE = (
    ".arw", ".avif", ".cr2", ".cr3", ".dng", ".exr", ".heic", ".heif", ".jxl", ".nef",
    ".orf", ".psd", ".raf", ".raw", ".rw2",
)  # fmt: skip
_BY_PATTERN = (".dib", ".hdr", ".jfif", ".jpe", ".pbm", ".pfm", ".pic", ".ras", ".sr")
_VIDEOS = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".ts", ".webm", ".wmv")
_SAME_KIND = {".jpeg": ".jpg", ".tiff": ".tif", ".pgm": ".pnm", ".ppm": ".pnm"}
_NAMED = 3  # files or folders that a message lists, at most
_LOOKED_AT = 200  # folders, for one that has pictures
# The number of a frame, as FFmpeg and renderers write it; a single # only before a suffix. In %20d,
# %20 is an encoded space.
_PRINTF = re.compile(
    r"%(0\d*|\d?)d|#{2,}|#(?=(" + "|".join(map(re.escape, IMAGE_SUFFIXES)) + ")$)", re.IGNORECASE
)


@dataclass(frozen=True)
class Found:
    """Pictures that were found, in order, and notes on the search."""

    files: list[Path]
    notes: tuple[str, ...] = ()


def pictures_of(folder: str) -> Found:
    """Return the pictures of a folder, hidden files apart; FileNotFoundError if it has none."""
    there = [file for file in Path(folder).iterdir() if not file.name.startswith(".")]
    files = [file for file in there if file.suffix.lower() in IMAGE_SUFFIXES]
    if not files:
        raise FileNotFoundError(f"the folder {folder} has no images{_instead(folder, there)}")
    return Found(in_order(files), tuple(_left_out(folder, there) + _of_kinds(folder, files)))


def matching_files(pattern: str) -> Found:
    """Return the files that match a glob pattern; FileNotFoundError if there is none.

    Brackets that match nothing as a pattern are taken literally: ``set [1]/*.png`` is the folder
    ``set [1]``, unless there is a ``set 1``.
    """
    matches = {written: files for written in _ways_of(pattern) if (files := _files_of(written))}
    if not matches:
        raise FileNotFoundError(f"no file matches {pattern}: {_advice(pattern)}")
    written, files = next(iter(matches.items()))
    notes = [
        f"{pattern} is read as a pattern, where [ ] stand for one character; for the files with "
        f"these brackets in their path, write {other}"
        for other, others in matches.items()
        if written == pattern and set(others) != set(files)
    ]
    return Found(in_order(files), tuple(notes[:1]))


def files_matching(pattern: str) -> list[Path]:
    """Return the files of `matching_files`, an empty list if there are none."""
    return next(filter(None, map(_files_of, _ways_of(pattern))), [])


def _ways_of(pattern: str) -> list[str]:
    """Return a pattern, and the same with literal brackets."""
    if "[" not in pattern:
        return [pattern]
    folder = os.path.dirname(pattern)
    while folder and not os.path.isdir(folder) and os.path.dirname(folder) != folder:
        folder = os.path.dirname(folder)
    escaped = glob.escape(folder)
    ways = (pattern, escaped + pattern[len(folder) :], pattern.replace("[", "[[]"))
    return list(dict.fromkeys(ways))


def several_pictures(path: str, name: str) -> list[Path]:
    """Return the pictures of a folder or pattern, or the one of a file.

    Raises
    ------
    FileNotFoundError
        If there is none; `name` is what the error calls it.
    """
    if os.path.isdir(path):
        return pictures_of(path).files
    if os.path.isfile(path):
        return [Path(path)]
    if glob.has_magic(path):
        return matching_files(path).files
    refuse_url(path)
    refuse_numbered(path)
    raise FileNotFoundError(f"there is no {name} {path}: check the path")


def order_notes(files: Sequence[Path]) -> list[str]:
    """Return a note if files are given in alphabetical order, but their names state another.

    A shell sorts so for a pattern that is not quoted.
    """
    if list(files) != sorted(files, key=str):
        return []  # somebody has chosen the order
    for given, wanted in zip(files, in_order(files), strict=True):
        if given != wanted:
            return [
                f"files are read in the order given, where {given.name} comes before "
                f"{wanted.name}; to have them in the order of their numbers or times, quote the "
                "pattern"
            ]
    return []


def refuse_numbered(path: str) -> None:
    """Raise FileNotFoundError for a pattern such as ``f%03d.png`` or ``f.####.png``.

    It says which glob pattern to write. Not if the path matches files as it is.
    """
    folder = os.path.dirname(path)
    while folder and not os.path.isdir(folder) and os.path.dirname(folder) != folder:
        folder = os.path.dirname(folder)
    rest = path[len(folder) :]
    if not _PRINTF.search(rest) or os.path.exists(path) or files_matching(path):
        return
    pattern = glob.escape(folder) + _PRINTF.sub("*", rest)
    are_there = "" if files_matching(pattern) else ", though no file matches it now"
    raise FileNotFoundError(
        f"there is no file {path}: for pictures with a number in their names write a pattern with "
        f"*, '{pattern}'{are_there}"
    )


def _files_of(pattern: str) -> list[Path]:
    return [file for file in map(Path, glob.glob(pattern)) if file.is_file()]


def _advice(pattern: str) -> str:
    """Return advice for a pattern that matches nothing."""
    folder = os.path.dirname(pattern)
    if folder and not glob.has_magic(folder) and not os.path.isdir(folder):
        return f"there is no folder {folder}"
    if "[" in pattern:
        return "check it; a [ that is part of a name is written [[]"
    return "check the pattern"


def _instead(folder: str, there: Sequence[Path]) -> str:
    """Return what a folder without pictures has instead, with advice."""
    videos = [file for file in there if file.suffix.lower() in _VIDEOS]
    if left_out := _left_out(folder, there, is_all=True):
        return ", but " + "; ".join(left_out)
    if videos:
        return f", but {_listed([file.name for file in videos])}: give the path of one video"
    if below := list(_folders_with_pictures(Path(folder))):
        begin = "a folder below it has" if len(below) == 1 else "folders below it have"
        return f", but {begin}: give {_listed([str(one) for one in below], 'or')}"
    return f": expected files ending in {', '.join(IMAGE_SUFFIXES)}"


def _folders_with_pictures(folder: Path) -> Iterator[Path]:
    """Yield folders below one that have pictures, the nearest first."""
    waiting, looked_at = [folder], 0
    while waiting and looked_at < _LOOKED_AT:
        here, looked_at = waiting.pop(0), looked_at + 1
        try:
            inside = sorted(
                (one for one in here.iterdir() if not one.name.startswith(".")), key=natural_order
            )
        except OSError:  # it may not be looked at
            continue
        if here != folder and any(one.suffix.lower() in IMAGE_SUFFIXES for one in inside):
            yield here
        waiting += [one for one in inside if one.is_dir() and not one.is_symlink()]


def _left_out(folder: str, there: Sequence[Path], *, is_all: bool = False) -> list[str]:
    """Return notes on files that are pictures by their suffix, but are not read."""
    notes = []
    for suffixes, advice in (
        (_UNREADABLE, "tisfm cannot read them; convert them to PNG or JPEG"),
        ((".gif",), "a GIF is read as a video; give the path of one GIF"),
        (_BY_PATTERN, "a folder is not searched for them; give a pattern such as {pattern}"),
    ):
        names = [file.name for file in there if file.suffix.lower() in suffixes]
        if not names:
            continue
        names.sort(key=lambda name: natural_order(Path(name)))
        pattern = os.path.join(glob.escape(folder), f"*{Path(names[0]).suffix}")
        advice = advice.format(pattern=pattern)
        if is_all:
            notes.append(f"it has {_listed(names)}: {advice}")
        else:
            one = len(names) == 1
            notes.append(
                f"{len(names)} picture{'s' * (not one)} in {folder} {'is' if one else 'are'} left "
                f"out ({_listed(names)}): {advice}"
            )
    return notes


def _of_kinds(folder: str, files: Sequence[Path]) -> list[str]:
    """Return a note on pictures of several kinds: they may be the same frames twice."""
    kinds = Counter(_SAME_KIND.get(one, one) for one in (file.suffix.lower() for file in files))
    if len(kinds) == 1:
        return []
    counted = ", ".join(f"{number} {kind}" for kind, number in kinds.most_common())
    usual = kinds.most_common(1)[0][0]
    pattern = os.path.join(glob.escape(folder), f"*{usual}")
    return [
        f"{folder} has pictures of several kinds ({counted}), and all are read, in the order of "
        f"their names; a pattern such as {pattern} takes one kind"
    ]


def _listed(names: Sequence[str], conjunction: str = "and") -> str:
    """Return a list of names, the first few of many."""
    if len(names) == 1:
        return names[0]
    if len(names) > _NAMED:
        rest = len(names) - _NAMED
        return f"{', '.join(names[:_NAMED])} {conjunction} {rest} more"
    return f"{', '.join(names[:-1])} {conjunction} {names[-1]}"
