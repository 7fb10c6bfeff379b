"""Videos that end before they should."""


def misses_frames(count: int, announced: int | None) -> bool:
    """Return whether there are fewer frames than announced, but for a few that are miscounted."""
    return announced is not None and count < announced - max(2, announced // 50)


def ends_early(count: int, last: float | None, end: float | None) -> bool | None:
    """Return whether the last frame comes long before the end that is stated, None if unknown.

    Parameters
    ----------
    count : int
        Number of frames.
    last, end : float or None
        Time of the last one, and of the end, s, where they are known.
    """
    if last is None or end is None:
        return None
    return last < 0.98 * end - 3 * last / max(count - 1, 1)


def cut_off(path: str, after: str, of: str) -> ValueError:
    """Return the error of a video that ends after less than it stated."""
    return ValueError(
        f"{path} ends after {after} of {of}: the file is cut off or damaged; the results up to "
        "there are complete"
    )
