"""Sequences of frames whose path or depth is known, anywhere below a folder."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from tisfm.checks import whole
from tisfm.datasets.finding import folders_below, root_of
from tisfm.datasets.sequence import LoadedSequence
from tisfm.datasets.sequence_layouts import SEQUENCE_LAYOUTS, SequenceLayout
from tisfm.formats import FormatError


@dataclass(frozen=True, kw_only=True)
class DatasetSequence:
    """Where a sequence lies. Nothing is read before `load`.

    Attributes
    ----------
    layout : str
        Name of the layout it was recognised by, one of `SEQUENCE_LAYOUTS`.
    name : str
        After its folder.
    folder : Path

    Examples
    --------
    >>> from tisfm.datasets import find_sequences
    >>> (sequence,) = find_sequences("calibrated")
    >>> sequence.name, len(sequence.load(step=2).frames)
    ('calibrated', 5)
    """

    layout: SequenceLayout
    name: str
    folder: Path

    def load(self, step: int = 1) -> LoadedSequence:
        """Read all but the frames and the depth maps, of every `step`-th frame.

        Raises
        ------
        FormatError
            If a file is damaged or says too little; the text names it.
        OSError
            If a file is missing or cannot be read.
        ValueError
            If `step` is not a positive whole number.
        """
        whole(1, step=step)
        loaded = SEQUENCE_LAYOUTS[self.layout].load(self.folder)
        loaded = loaded.take(range(0, len(loaded.frames), step))
        if len(loaded.frames) < 2:
            raise FormatError(
                f"{self.folder} has {len(loaded.frames)} frames at a step of {step}, expected at "
                "least 2"
            )
        return loaded


def find_sequences(
    folder: str | os.PathLike[str], layout: SequenceLayout | None = None
) -> list[DatasetSequence]:
    """Find the sequences in a folder, and in all folders below it, whose path or depth is known.

    Parameters
    ----------
    folder : str or os.PathLike
        Folder of a sequence, or of several. Links to folders are followed, and hidden folders
        left out.
    layout : str, optional
        How the files are laid out, one of `SEQUENCE_LAYOUTS`; by default, every layout that is
        recognised.

    Returns
    -------
    list of DatasetSequence
        In the order of their folders, at least one.

    Raises
    ------
    FileNotFoundError
        If there is no such folder, or no sequence in it; the text says what was looked for.
    NotADirectoryError
        If `folder` is a file.
    ValueError
        If there is no such layout.

    Examples
    --------
    >>> from tisfm.datasets import find_sequences
    >>> for sequence in find_sequences("calibrated"):  # images/, camera.txt, poses.txt, depth/
    ...     print(sequence.layout, len(sequence.load().frames))
    calibrated 9
    """
    names = get_args(SequenceLayout)
    if layout is not None and layout not in names:
        raise ValueError(
            f"layout is {layout!r}: expected one of {', '.join(map(repr, names))}, or None"
        )
    root = root_of(folder)
    wanted = {
        name: rule for name, rule in SEQUENCE_LAYOUTS.items() if layout is None or name == layout
    }
    found = [
        DatasetSequence(layout=name, name=rule.name(place), folder=place)
        for place in folders_below(Path(os.path.abspath(root)))
        for name, rule in wanted.items()
        if rule.recognises(place)
    ]
    if not found:
        expected = "; ".join(f"{name}: {rule.expected}" for name, rule in wanted.items())
        raise FileNotFoundError(
            f"{root} holds no sequence whose path or depth is known. Looked there and in the "
            f"folders below for {expected}"
        )
    return found
