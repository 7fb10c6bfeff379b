"""Masks of what moves, or is not visible, as black and white pictures."""

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from tisfm.exports.pieces import chosen_frames
from tisfm.exports.result_frames import ResultFrames
from tisfm.folders.result_folder import make_subfolder
from tisfm.formats import write_png


def write_masks(
    frames: ResultFrames,
    folder: str | os.PathLike[str],
    *,
    chosen: Iterable[int] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write black and white masks of every frame, a folder for each kind.

    Parameters
    ----------
    frames : ResultFrames
        Of a reconstruction with ``motion="objects"``: ``at-rest`` is white where nothing moves on
        its own, and ``object-1`` and so on where the thing of this id is. Of pairs: ``visible`` is
        white where a pixel is visible in the next frame; with ``motion="objects"``, ``motion-0``
        and so on where it has this motion, whose numbers are of the pair alone.
    folder : path
        It has to exist. Files are called like the frames, in folders called like the masks.
    chosen : iterable of int, optional
        Numbers of frames; by default all.
    progress : callable, optional
        Called with the number of frames that are done, and of all.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    ValueError
        If the result has none.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import SequenceFrames, write_masks
    >>> frames = SequenceFrames(tisfm.Reconstruction.load("bodies"))  # of ``motion="objects"``
    >>> written = write_masks(frames, ".", chosen=[0])
    >>> written[0].parent.name
    'at-rest'
    """
    taken, written = chosen_frames(chosen, len(frames)), []
    for done, frame in enumerate(taken, 1):
        for name, mask in frames.masks(frame).items():
            place = make_subfolder(Path(folder) / name)
            file = place / f"{frames.names[frame]}.png"
            write_png(file, np.where(mask, np.uint8(255), np.uint8(0)))
            written.append(file)
        if progress is not None:
            progress(done, len(taken))
    return written
