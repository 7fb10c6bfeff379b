"""The image files of a folder or a glob pattern, in the order of their names."""

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
from tisfm.formats.image_names import natural_sort_key, sort_by_name

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://?", re.DOTALL)
_URL_WITHOUT_SCHEME = re.compile(r"www\.[^/]+\.[^/]+(/|$)|youtu\.be/")  # as browsers show URLs
_STREAM_SCHEMES = ("mms", "rtmp", "rtmps", "rtp", "rtsp", "rtsps", "srt", "tcp", "udp", "v4l2")

# Suffixes of images that tisfm cannot read.
_UNREADABLE_SUFFIXES = (
    ".arw", ".avif", ".cr2", ".cr3", ".dng", ".exr", ".heic", ".heif", ".jxl", ".nef",
    ".orf", ".psd", ".raf", ".raw", ".rw2",
)  # fmt: skip
# Suffixes of images that are read if a pattern matches them; in a folder, such files are left out.
_PATTERN_SUFFIXES = (".dib", ".hdr", ".jfif", ".jpe", ".pbm", ".pfm", ".pic", ".ras", ".sr")
_VIDEO_SUFFIXES = (
    ".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".ts", ".webm", ".wmv",
)  # fmt: skip
_MAIN_SUFFIX = {".jpeg": ".jpg", ".tiff": ".tif", ".pgm": ".pnm", ".ppm": ".pnm"}
_MAX_LISTED_NAMES = 3  # names of files or folders in a message
_MAX_SEARCHED_FOLDERS = 200  # folders to search for images, for advice; set by hand
# The placeholder of FFmpeg and renderers for a frame number (%03d, ####). A single # counts only
# before a suffix. %20d does not count: %20 is an encoded space.
_FRAME_NUMBER = re.compile(
    r"%(0\d*|\d?)d|#{2,}|#(?=(" + "|".join(map(re.escape, IMAGE_SUFFIXES)) + ")$)", re.IGNORECASE
)


@dataclass(frozen=True)
class ImageSelection:
    """Image files in the order of the frames, and notes to the user on their selection."""

    files: list[Path]
    notes: tuple[str, ...] = ()


def refuse_url(source: str) -> None:
    """Raise ValueError if a source is a URL; the message says what to do instead."""
    match = _URL.match(source)
    lacks_scheme = _URL_WITHOUT_SCHEME.match(source) and not os.path.exists(source.split("/")[0])
    if match is None and not lacks_scheme:
        return
    scheme = match[1].lower() if match else "https"
    if scheme == "file":
        path = _path_of_url(source)
        advice = f"give the path, {path}" if path else "give the path of the file"
    elif scheme in _STREAM_SCHEMES:
        advice = (
            "record a part of it to a file first, for instance by "
            f"`ffmpeg -i {source} -t 60 -c copy film.mkv`, and give the path of this file"
        )
    else:
        advice = "download the file, and give its path"
    raise InputError(f"{source} is a URL, and only files are read: {advice}")


def _path_of_url(url: str) -> str:
    """Return the path in a file:// URL; "" for a path on another machine."""
    try:
        parts = urlsplit(url)
    except ValueError:
        return ""
    return url2pathname(parts.path) if parts.netloc in ("", "localhost") else ""


def list_images(folder: str) -> ImageSelection:
    """Return the images of a folder, without hidden files.

    Raises FileNotFoundError if the folder has no images.
    """
    visible_paths = [file for file in Path(folder).iterdir() if not file.name.startswith(".")]
    files = [file for file in visible_paths if file.suffix.lower() in IMAGE_SUFFIXES]
    if not files:
        advice = _advice_without_images(folder, visible_paths)
        raise FileNotFoundError(f"the folder {folder} has no images{advice}")
    notes = _skipped_notes(folder, visible_paths) + _formats_note(folder, files)
    return ImageSelection(sort_by_name(files), tuple(notes))


def match_pattern(pattern: str) -> ImageSelection:
    """Return the files that match a glob pattern.

    If no file matches, brackets are read as part of the name: ``set [1]/*.png`` are the files of
    the folder ``set [1]``, unless there is a folder ``set 1``.

    Raises FileNotFoundError if no file matches in either way.
    """
    matches = {
        variant: files for variant in _pattern_variants(pattern) if (files := _glob_files(variant))
    }
    if not matches:
        raise FileNotFoundError(f"no file matches {pattern}: {_advice_on_pattern(pattern)}")
    variant, files = next(iter(matches.items()))
    notes = [
        f"{pattern} is read as a pattern, where [ ] stand for one character; for the files with "
        f"these brackets in their path, write {other_variant}"
        for other_variant, other_files in matches.items()
        if variant == pattern and set(other_files) != set(files)
    ]
    return ImageSelection(sort_by_name(files), tuple(notes[:1]))


def files_of_pattern(pattern: str) -> list[Path]:
    """Return the files that `match_pattern` returns, or an empty list."""
    return next(filter(None, map(_glob_files, _pattern_variants(pattern))), [])


def _pattern_variants(pattern: str) -> list[str]:
    """Return a pattern, and the same pattern with brackets as part of the name."""
    if "[" not in pattern:
        return [pattern]
    folder = _existing_folder(pattern)
    pattern_end = pattern[len(folder) :]
    variants = (pattern, glob.escape(folder) + pattern_end, pattern.replace("[", "[[]"))
    return list(dict.fromkeys(variants))


def _existing_folder(path: str) -> str:
    """Return the longest beginning of a path that is an existing folder, or ""."""
    folder = os.path.dirname(path)
    while folder and not os.path.isdir(folder) and os.path.dirname(folder) != folder:
        folder = os.path.dirname(folder)
    return folder


def list_image_files(path: str, name: str) -> list[Path]:
    """Return the images of a folder or pattern, or a single file as a list.

    Raises FileNotFoundError if there are no images; the message calls the images `name`.
    """
    if os.path.isdir(path):
        return list_images(path).files
    if os.path.isfile(path):
        return [Path(path)]
    if glob.has_magic(path):
        return match_pattern(path).files
    refuse_url(path)
    refuse_numbered_pattern(path)
    raise FileNotFoundError(f"there is no {name} {path}: check the path")


def order_notes(files: Sequence[Path]) -> list[str]:
    """Return a note if files are in alphabetical order, and not in the order of their numbers.

    A shell sorts the files of an unquoted pattern alphabetically. If the order is different, the
    user has chosen this order.
    """
    if list(files) != sorted(files, key=str):
        return []
    for first, sorted_first in zip(files, sort_by_name(files), strict=True):
        if first != sorted_first:
            return [
                f"files are read in the order given, where {first.name} comes before "
                f"{sorted_first.name}; to read them in the order of their numbers or times, quote "
                "the pattern"
            ]
    return []


def refuse_numbered_pattern(path: str) -> None:
    """Raise FileNotFoundError for a pattern such as ``f%03d.png`` or ``f.####.png``.

    The message contains the right glob pattern. A path is accepted if it exists or matches files.
    """
    folder = _existing_folder(path)
    pattern_end = path[len(folder) :]
    if not _FRAME_NUMBER.search(pattern_end) or os.path.exists(path) or files_of_pattern(path):
        return
    pattern = glob.escape(folder) + _FRAME_NUMBER.sub("*", pattern_end)
    no_match_text = "" if files_of_pattern(pattern) else ", though no file matches it now"
    raise FileNotFoundError(
        f"there is no file {path}: for pictures with a number in their names write a pattern with "
        f"*, '{pattern}'{no_match_text}"
    )


def _glob_files(pattern: str) -> list[Path]:
    return [file for file in map(Path, glob.glob(pattern)) if file.is_file()]


def _advice_on_pattern(pattern: str) -> str:
    """Return advice for a pattern that no file matches."""
    folder = os.path.dirname(pattern)
    if folder and not glob.has_magic(folder) and not os.path.isdir(folder):
        return f"there is no folder {folder}"
    if "[" in pattern:
        return "check it; a [ that is part of a name is written [[]"
    return "check the pattern"


def _advice_without_images(folder: str, visible_paths: Sequence[Path]) -> str:
    """Return advice for a folder without images, from its visible files and folders."""
    videos = [file for file in visible_paths if file.suffix.lower() in _VIDEO_SUFFIXES]
    if skipped_notes := _skipped_notes(folder, visible_paths, is_folder_unread=True):
        return ", but " + "; ".join(skipped_notes)
    if videos:
        return f", but {_join_names([file.name for file in videos])}: give the path of one video"
    if subfolders := list(_folders_with_images(Path(folder))):
        subject = "a folder below it has" if len(subfolders) == 1 else "folders below it have"
        return f", but {subject}: give {_join_names([str(path) for path in subfolders], 'or')}"
    return f": expected files ending in {', '.join(IMAGE_SUFFIXES)}"


def _folders_with_images(folder: Path) -> Iterator[Path]:
    """Yield the subfolders with images, in order of increasing depth."""
    queue, search_count = [folder], 0
    while queue and search_count < _MAX_SEARCHED_FOLDERS:
        current, search_count = queue.pop(0), search_count + 1
        try:
            visible_paths = [path for path in current.iterdir() if not path.name.startswith(".")]
        except OSError:  # no permission to list the folder
            continue
        paths = sorted(visible_paths, key=natural_sort_key)
        if current != folder and any(path.suffix.lower() in IMAGE_SUFFIXES for path in paths):
            yield current
        queue += [path for path in paths if path.is_dir() and not path.is_symlink()]


def _skipped_notes(
    folder: str, visible_paths: Sequence[Path], *, is_folder_unread: bool = False
) -> list[str]:
    """Return notes on files that have the suffix of an image, but are not read.

    `is_folder_unread`: whether no file of the folder is read.
    """
    notes = []
    for suffixes, advice in (
        (_UNREADABLE_SUFFIXES, "tisfm cannot read them; convert them to PNG or JPEG"),
        ((".gif",), "a GIF is read as a video; give the path of one GIF"),
        (_PATTERN_SUFFIXES, "a folder is not searched for them; give a pattern such as {pattern}"),
    ):
        names = [file.name for file in visible_paths if file.suffix.lower() in suffixes]
        if not names:
            continue
        names.sort(key=lambda name: natural_sort_key(Path(name)))
        pattern = os.path.join(glob.escape(folder), f"*{Path(names[0]).suffix}")
        advice = advice.format(pattern=pattern)
        if is_folder_unread:
            notes.append(f"it has {_join_names(names)}: {advice}")
        else:
            is_single = len(names) == 1
            notes.append(
                f"{len(names)} picture{'s' * (not is_single)} in {folder} "
                f"{'is' if is_single else 'are'} left out ({_join_names(names)}): {advice}"
            )
    return notes


def _formats_note(folder: str, files: Sequence[Path]) -> list[str]:
    """Return a note on images in several formats: a folder may have each frame twice."""
    suffixes = (file.suffix.lower() for file in files)
    kind_counts = Counter(_MAIN_SUFFIX.get(suffix, suffix) for suffix in suffixes)
    if len(kind_counts) == 1:
        return []
    counts_text = ", ".join(f"{number} {kind}" for kind, number in kind_counts.most_common())
    most_common = kind_counts.most_common(1)[0][0]
    pattern = os.path.join(glob.escape(folder), f"*{most_common}")
    return [
        f"{folder} has pictures of several kinds ({counts_text}), and all are read, in the order "
        f"of their names; a pattern such as {pattern} takes one kind"
    ]


def _join_names(names: Sequence[str], conjunction: str = "and") -> str:
    """Return names as text; if there are many, only the first `_MAX_LISTED_NAMES`."""
    if len(names) == 1:
        return names[0]
    if len(names) > _MAX_LISTED_NAMES:
        rest_count = len(names) - _MAX_LISTED_NAMES
        return f"{', '.join(names[:_MAX_LISTED_NAMES])} {conjunction} {rest_count} more"
    return f"{', '.join(names[:-1])} {conjunction} {names[-1]}"
