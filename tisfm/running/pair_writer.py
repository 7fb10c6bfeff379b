"""The folder that `tisfm run` and `tisfm demo` write to: its record, and ranges of all pairs."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.folders.result_folder import InputFiles, locked_folder, make_result_folder
from tisfm.folders.run_record import ENDINGS, FOUND, RECORD, TABLE, RunRecord
from tisfm.folders.side_files import TIMINGS
from tisfm.interpretation import Interpretation
from tisfm.report import REPORT, is_report
from tisfm.running.pair_files import USUAL, PairFiles, Ranges, Sums, checked_outputs
from tisfm.settings import Settings
from tisfm.show.stereo import DISPARITY
from tisfm.version import __version__

_RANGES = ("depth16", "depth", "flow", "screen")  # in the order of `FOUND`


class PairWriter:
    """Writes interpretations into a folder, with one range for all, and keeps its record.

    For a pair named ``name``: ``name_depth16.png`` (16-bit depth, its scale written in the file
    and in the record), ``name_depth.png`` (grey levels, near is bright), ``name_flow.flo``,
    ``name_anaglyph.png``, ``name_figure.png``, ``name.ply``, of rigid motions ``name_pose.txt``,
    and last ``name.npz``. The record, ``run.json``, holds settings, camera, ranges, and of every
    finished pair its status, its rigid motions, a hash of its frames, and what its files are; a
    pair that is not in it is not complete.

    The writer is a context manager. Within the block nobody else writes to the folder. What an
    earlier run wrote into it is removed with the first pair, unless that run is continued.

    Parameters
    ----------
    folder : path
        Made if it does not exist.
    camera : Camera
        Of the frames as they are interpreted.
    settings : Settings
    source : (Camera, (int, int)), optional
        The camera of the source's frames, before they are cropped and shrunk, and their height and
        width, px.
    window : int
        How many frames an interpretation sees.
    outputs : collection of str
        What is written of a pair: the keys of `ENDINGS`.
    figures : int
        Figures are drawn of every so many pairs, from the first on; 0 for none.
    disparity, screen : float, float or None
        Of anaglyphs, as for `PairFiles`.
    start, step : int
        The first frame of the source that is taken, and how many there are to the next.
    resume : bool
        Continue a run that was interrupted: keep its ranges and the pairs it finished.
    inputs : InputFiles
        Files that are not to be replaced.
    names : iterable of str
        Names of pairs to come, as far as they are known: their files are compared with `inputs`
        before anything is written, and all files once more when they are.

    Attributes
    ----------
    folder : Path
    camera : Camera
    files : PairFiles
        Writes the files of a pair alone.

    Raises
    ------
    OSError
        If the folder cannot be made or written to; where the block begins, if another run writes to
        it.
    ValueError
        If a file to be written is one of `inputs`; where the block begins, if `resume` is set and
        the folder holds a run with another camera or other options.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        camera: Camera,
        settings: Settings,
        source: tuple[Camera, tuple[int, int]] | None = None,
        window: int = 2,
        outputs: Collection[str] = USUAL,
        figures: int = 1,
        disparity: float = DISPARITY,
        screen: float | None = None,
        start: int = 0,
        step: int = 1,
        resume: bool = False,
        inputs: InputFiles | None = None,
        names: Iterable[str] = (),
        notes: Sequence[str] = (),
    ) -> None:
        self.folder, self.camera = Path(folder), camera
        self._inputs = inputs or InputFiles()
        chosen = checked_outputs(outputs)
        self.files = PairFiles(
            folder=self.folder,
            outputs=chosen,
            figures=figures if "figure" in chosen else 0,
            has_pose=settings.motion != "field",
            disparity=disparity,
            screen=screen,
            inputs=self._inputs,
        )
        self._inputs.refuse(
            *(self.folder / name for name in (RECORD, TABLE, TIMINGS)),
            *(file for name in names for file in self.files.all(name)),
        )
        make_result_folder(folder)
        asked = {
            "version": __version__,
            "arch": None,
            "lanes": None,
            "camera": asdict(camera),
            "source": None if source is None else _about_source(*source),
            "settings": asdict(settings),
            "window": window,
            "outputs": list(chosen),
            "figures": self.files.figures,
            "start": start,
            "step": step,
            # Of runs without anaglyphs it is no matter.
            "disparity": disparity if "anaglyph" in chosen else None,
            "screen": screen if "anaglyph" in chosen else None,
        }
        self._earlier: list[Path] = []
        self._record = RunRecord(self.folder, asked, notes)
        self._with = ExitStack()
        self._resume = self._is_begun = resume
        self._has_report = True  # as far as is known

    def result_of(self, name: str) -> Path:
        """Return the file of a pair's interpretation."""
        return self.folder / f"{name}.npz"

    def is_complete(self, name: str, digest: str, number: int) -> bool:
        """Return whether an earlier run finished this pair, as `RunRecord.is_complete` says."""
        return self._record.is_complete(name, digest, self.files.endings(number))

    def knows(self, name: str) -> bool:
        """Return whether a pair of this name was written, by this run or the one continued."""
        return name in self._record.pairs

    def took(self, name: str, seconds: float) -> None:
        """Take down how long a pair was interpreted."""
        self._record.took(name, seconds)

    def write(
        self, name: str, result: Interpretation, *, pose: np.ndarray | None = None, **about: Any
    ) -> None:
        """Write all files of a pair, as `PairFiles.write` does, and take down that it is finished.

        The first pair that shows depth sets the ranges of all.
        """
        self.begin()
        self._remove_report()
        if self.ranges is None:
            posed = pose is not None
            self.ranges = Ranges.of(result, posed=posed, screen=self.files.screen)
        written = self.files.write(name, result, ranges=self.ranges, pose=pose, **about)
        self._record.finish(name, *written)

    def finish(self, name: str, about: Mapping[str, Any], sums: Sums) -> None:
        """Take down that a pair is finished whose files another process wrote."""
        self._remove_report()
        self._record.finish(name, about, sums)

    def begin(self) -> None:
        """Remove what an earlier run wrote here, its record last: until then it can be told."""
        if self._is_begun:
            return
        self._is_begun = True
        self._inputs.refuse(*self._earlier)
        self._remove_report()
        records = (self.folder / name for name in (TABLE, TIMINGS, RECORD))
        for file in (*self._earlier, *records):
            file.unlink(missing_ok=True)

    def _remove_report(self) -> None:
        """Remove the page of an earlier command, once: it has no pair of this one."""
        report, self._has_report = self._has_report, False
        if report and is_report(self.folder / REPORT):
            (self.folder / REPORT).unlink(missing_ok=True)

    @property
    def ranges(self) -> Ranges | None:
        """What pictures are drawn in; None until a pair shows depth."""
        found = [self._record[key] for key in FOUND]
        if any(value is None for value in found):
            return None
        return Ranges(**dict(zip(_RANGES, found, strict=True)))

    @ranges.setter
    def ranges(self, ranges: Ranges | None) -> None:
        for key, name in zip(FOUND, _RANGES, strict=True):
            self._record[key] = None if ranges is None else getattr(ranges, name)

    def known(self, first: int, end: int) -> dict[str, Mapping[str, Any]]:
        """Return what the record says of pairs with these numbers, by their names."""
        return {
            name: pair for name, pair in self._record.pairs.items() if first <= pair["number"] < end
        }

    @property
    def statuses(self) -> Mapping[str, int]:
        """How many pairs have which status code so far, those of a resumed run included."""
        return {code: count for code, count in list(self._record.statuses.items()) if count}

    @property
    def seconds(self) -> list[float]:
        """Times of the pairs that this command interpreted, s."""
        return list(self._record.seconds.values())

    @property
    def times_note(self) -> str:
        """Why the times of frames cannot serve a path; "" if they can, or no time is known."""
        return self._record.times_note()

    @property
    def advice(self) -> dict[str, str]:
        """The message of the first pair of every status code other than ``"converged"``."""
        messages: dict[str, str] = {}
        for pair in self._record.pairs.values():
            if pair["status"] != "converged":
                messages.setdefault(pair["status"], pair["message"])
        return messages

    def expected_bytes(self, count: int) -> float:
        """Return how much so many pairs take, by the first one that is finished."""
        pair = next(iter(list(self._record.pairs.values())))
        lengths = {ending: length for ending, (length, _) in pair["files"].items()}
        figure = lengths.pop(ENDINGS["figure"], 0)
        figures = -(-count // self.files.figures) if self.files.figures else 0
        return float(sum(lengths.values()) * count + figure * figures)

    def __enter__(self) -> "PairWriter":
        with ExitStack() as opened:
            opened.enter_context(locked_folder(self.folder))
            runtime.start()
            self._record["arch"] = runtime.running_arch()
            self._record["lanes"] = runtime.lanes()
            self._earlier = self._record.look()
            if self._resume:
                self._record.resume()
            else:
                self._inputs.refuse(*self._earlier)
            self._with = opened.pop_all()
        return self

    def __exit__(self, *about: object) -> None:
        with self._with:
            self._inputs.refuse(*(self.folder / name for name in (RECORD, TABLE, TIMINGS)))
            self._record.write()


def _about_source(camera: Camera, shape: tuple[int, int]) -> dict[str, float]:
    """Return the size and the focal length of the source's frames, px, for the record."""
    return {"focal": camera.focal, "width": shape[1], "height": shape[0]}
