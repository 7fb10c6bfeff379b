"""Search for pairs and sequences with ground truth below a folder."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from tisfm.checks import check_whole_numbers
from tisfm.datasets.pair import DatasetPair
from tisfm.datasets.pair_layouts import LAYOUTS, Layout, PairRule
from tisfm.datasets.sequence import LoadedSequence
from tisfm.datasets.sequence_layouts import SEQUENCE_LAYOUTS, SequenceLayout
from tisfm.errors import InputError
from tisfm.formats import FormatError


def find_pairs(
    folder: str | os.PathLike[str], layout: Layout | None = None, *, step: int | None = None
) -> list[DatasetPair]:
    """Find the pairs of frames with ground truth in a folder, and in all folders below it.

    Parameters
    ----------
    folder : str or os.PathLike
        Folder of a dataset, or of several. Links to folders are followed, and hidden folders
        left out.
    layout : str, optional
        How the files are laid out, one of `LAYOUTS`; by default, every layout that is recognised.
    step : int, optional
        In a sequence ("new_tsukuba", "sevenscenes", "calibrated") the pairs are the frames i and
        i + `step`, for every i; by default 1, 3 and 1. In other datasets files define the pairs.

    Returns
    -------
    list of DatasetPair
        At least one pair, in the order of folders and names. No image is read yet.

    Raises
    ------
    FileNotFoundError
        If there is no such folder, or no pair in it; the message lists the expected files.
    NotADirectoryError
        If `folder` is a file.
    ValueError
        If there is no such layout, or `step` is not a positive whole number.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tisfm.datasets import find_pairs
    >>> from tisfm.formats import write_flo, write_png
    >>> from tisfm.scenes import two_blocks
    >>> scene, folder = two_blocks(48, 64), Path("mine/Blocks")
    >>> folder.mkdir(parents=True)
    >>> write_png(folder / "frame10.png", scene.frame0)
    >>> write_png(folder / "frame11.png", scene.frame1)
    >>> write_flo(folder / "flow10.flo", scene.flow)
    >>> for pair in find_pairs("mine"):
    ...     print(pair.layout, pair.name, pair.load().flow.shape)
    middlebury Blocks (48, 64, 2)
    """
    if layout is not None and layout not in LAYOUTS:
        raise InputError(
            f"layout is {layout!r}: expected one of {', '.join(map(repr, LAYOUTS))}, or None"
        )
    if step is not None and (not isinstance(step, int) or isinstance(step, bool) or step < 1):
        raise InputError(f"step is {step!r}: expected a positive whole number")
    root = check_folder(folder)
    rules = list(LAYOUTS.values()) if layout is None else [LAYOUTS[layout]]
    # The absolute path: datasets are named after folders, and "." and ".." are not names.
    pairs = [
        pair
        for subfolder in walk_folders(Path(os.path.abspath(root)))
        for rule in rules
        for pair in _find_pairs_in(rule, subfolder, step)
    ]
    if not pairs:
        names = [layout] if layout is not None else list(LAYOUTS)
        expected_files = "; ".join(f"{name}: {LAYOUTS[name].expected_files}" for name in names)
        raise FileNotFoundError(
            f"{root} holds no pair of frames with a truth. tisfm searched it and the folders "
            f"below for {expected_files}"
        )
    return pairs


def check_folder(folder: str | os.PathLike[str]) -> Path:
    """Return the path of an existing folder, or raise the errors of `find_pairs`."""
    root = Path(folder)
    if not root.exists():
        raise FileNotFoundError(
            f"there is no folder {root}: check the path (relative paths start at {os.getcwd()})"
        )
    if not root.is_dir():
        raise NotADirectoryError(f"{root} is a file: give the folder of a dataset")
    return root


def _find_pairs_in(rule: PairRule, folder: Path, step: int | None) -> Iterator[DatasetPair]:
    """Yield the pairs of a layout in one folder."""
    return rule.find(folder) if rule.step is None else rule.find(folder, step=step or rule.step)


def walk_folders(root: Path) -> Iterator[Path]:
    """Yield a folder and all folders below it, each once, in the order of their names."""
    visited = set()
    for folder, subfolders, _ in os.walk(root, followlinks=True):
        real_path = os.path.realpath(folder)
        if real_path in visited:  # a link leads to a folder that was visited
            subfolders.clear()
            continue
        visited.add(real_path)
        subfolders[:] = sorted(name for name in subfolders if not name.startswith("."))
        yield Path(folder)


@dataclass(frozen=True, kw_only=True)
class DatasetSequence:
    """A sequence in a folder. Nothing is read before `load`.

    Attributes
    ----------
    layout : str
        Name of its layout, one of `SEQUENCE_LAYOUTS`.
    name : str
        Name of the sequence, after its folder.
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
        """Read poses, times and camera of every `step`-th frame; not the frames and depth maps.

        Raises
        ------
        FormatError
            If a file is damaged or incomplete; the message names it.
        OSError
            If a file is missing or cannot be read.
        ValueError
            If `step` is not a positive whole number.
        """
        check_whole_numbers(1, step=step)
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
    """Find the sequences with true poses or depth in a folder, and in all folders below it.

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
        At least one sequence, in the order of the folders.

    Raises
    ------
    FileNotFoundError
        If there is no such folder, or no sequence in it; the message lists the expected files.
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
        raise InputError(
            f"layout is {layout!r}: expected one of {', '.join(map(repr, names))}, or None"
        )
    root = check_folder(folder)
    rules = {
        name: rule for name, rule in SEQUENCE_LAYOUTS.items() if layout is None or name == layout
    }
    sequences = [
        DatasetSequence(layout=name, name=rule.name(subfolder), folder=subfolder)
        for subfolder in walk_folders(Path(os.path.abspath(root)))
        for name, rule in rules.items()
        if rule.recognises(subfolder)
    ]
    if not sequences:
        expected_files = "; ".join(f"{name}: {rule.expected_files}" for name, rule in rules.items())
        raise FileNotFoundError(
            f"{root} holds no sequence whose path or depth is known. tisfm searched it and the "
            f"folders below for {expected_files}"
        )
    return sequences
