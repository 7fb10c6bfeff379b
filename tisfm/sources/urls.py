"""URLs instead of paths: they are refused, with advice."""

import os
import re
from urllib.parse import urlsplit
from urllib.request import url2pathname

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
    raise ValueError(f"{source} is a URL, and only files are read: {instead}")


def _path_of(url: str) -> str:
    """Return the path that a file:// URL stands for, "" if it is of another machine."""
    try:
        parts = urlsplit(url)
    except ValueError:
        return ""
    return url2pathname(parts.path) if parts.netloc in ("", "localhost") else ""
