"""Pairs with true motion anywhere below a folder."""

import os
from collections.abc import Iterator
from pathlib import Path

from tisfm.datasets.layouts import LAYOUTS, Layout
from tisfm.datasets.pair import DatasetPair


def find_pairs(folder: str | os.PathLike[str], layout: Layout | None = None) -> list[DatasetPair]:
    """Find the pairs of frames with true motion in a folder, and in all folders below it.

    Parameters
    ----------
    folder : str or os.PathLike
        Folder of a dataset, or of several. Links to folders are followed, and hidden folders
        left out.
    layout : {"middlebury", "kitti", "sintel", "yosemite", "stereo"}, optional
        How the files are laid out; by default, every layout that is recognised.

    Returns
    -------
    list of DatasetPair
        In the order of their folders and names, at least one. No picture is read yet.

    Raises
    ------
    FileNotFoundError
        If there is no such folder, or no pair in it; the text says what was looked for.
    NotADirectoryError
        If `folder` is a file.
    ValueError
        If there is no such layout.

    Examples
    --------
    >>> from tisfm.datasets import find_pairs
    >>> for pair in find_pairs("middlebury"):  # doctest: +SKIP
    ...     loaded = pair.load()  # frames, flow with NaN where unknown, occlusion, camera
    """
    if layout is not None and layout not in LAYOUTS:
        raise ValueError(
            f"layout is {layout!r}: expected one of {', '.join(map(repr, LAYOUTS))}, or None"
        )
    root = Path(folder)
    if not root.exists():
        raise FileNotFoundError(
            f"there is no folder {root}: check the path (relative paths start at {os.getcwd()})"
        )
    if not root.is_dir():
        raise NotADirectoryError(f"{root} is a file: give the folder of a dataset")
    rules = list(LAYOUTS.values()) if layout is None else [LAYOUTS[layout]]
    # Datasets are named after folders, and "." and ".." are no names.
    pairs = [
        pair
        for place in _folders(Path(os.path.abspath(root)))
        for rule in rules
        for pair in rule.find(place)
    ]
    if not pairs:
        names = [layout] if layout is not None else list(LAYOUTS)
        expected = "; ".join(f"{name}: {LAYOUTS[name].expected}" for name in names)
        raise FileNotFoundError(
            f"{root} holds no pair of frames with true motion. Looked there and in the folders "
            f"below for {expected}"
        )
    return pairs


def _folders(root: Path) -> Iterator[Path]:
    """Yield a folder and all below it, each once, in order of their names."""
    seen = set()
    for place, below, _ in os.walk(root, followlinks=True):
        real = os.path.realpath(place)
        if real in seen:  # by a link to a folder above, or to one of the others
            below.clear()
            continue
        seen.add(real)
        below[:] = sorted(name for name in below if not name.startswith("."))
        yield Path(place)
