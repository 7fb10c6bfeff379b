"""The writer of the folder of `tisfm run` and `tisfm demo`: files, record, and common ranges."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.folders.files import TIMINGS
from tisfm.folders.result_folder import InputFiles, locked_folder, make_result_folder
from tisfm.folders.run_record import ENDINGS, RANGE_KEYS, RECORD, TABLE, RunRecord
from tisfm.grade import GradeSummary, upper_median
from tisfm.interpretation import Interpretation
from tisfm.report import REPORT, is_report
from tisfm.running.pair_files import DEFAULT_OUTPUTS, Checksums, PairFiles, Ranges, check_outputs
from tisfm.settings import FixedPixels, Settings
from tisfm.show.stereo import DISPARITY
from tisfm.status import FOCAL_NOTE
from tisfm.version import __version__

_RANGE_FIELDS = ("depth16", "depth", "flow", "screen")  # in the order of `RANGE_KEYS`


class PairWriter:
    """Writes interpretations into a folder, with common ranges of values, and its record.

    The files of a pair named ``name`` are ``name_depth16.png`` (16-bit depth, with its scale in the
    file and in the record), ``name_depth.png`` (grey levels, near is bright), ``name_flow.flo``,
    ``name_anaglyph.png``, ``name_figure.png``, ``name.ply``, for rigid motions ``name_pose.txt``,
    and last ``name.npz``. The record, ``run.json``, has settings, camera and ranges, and an entry
    for every finished pair: the status, the rigid motions, a hash of the frames, and the check sums
    of the files. A pair without an entry is not complete.

    The writer is a context manager, which locks the folder. Unless it resumes an earlier run, it
    removes the files of this run before it writes the first pair.

    Raises OSError if the folder cannot be made or written to; at the beginning of the block, if
    another run writes to it.

    Raises ValueError if an output file is one of `inputs`; at the beginning of the block, if
    `resume` is set and the folder has a run with another camera or other options.
    """

    def __init__(
        self,
        folder: str | Path,  # created if it does not exist
        *,
        camera: Camera,  # the camera of the interpreted frames
        settings: Settings,
        # camera, height and width (px) of the source's frames, before crop and reduction
        source: tuple[Camera, tuple[int, int]] | None = None,
        window: int = 2,  # number of frames of an interpretation
        fixed_pixels: FixedPixels = "mask",  # as for `tisfm.interpret`
        outputs: Collection[str] = DEFAULT_OUTPUTS,  # the outputs of a pair: keys of `ENDINGS`
        figures: int = 1,  # interval of pairs with a figure; 0 for no figures
        # disparity, screen: parameters of anaglyphs, as for `PairFiles`
        disparity: float = DISPARITY,
        screen: float | None = None,
        # start, step: number of the first selected frame, and frames from one to the next
        start: int = 0,
        step: int = 1,
        resume: bool = False,  # whether to keep ranges and finished pairs of an interrupted run
        inputs: InputFiles | None = None,  # files that no result may replace
        # known names of coming pairs: their files are compared with `inputs` before the run writes
        # any file, and once more at their writing
        names: Iterable[str] = (),
        notes: Sequence[str] = (),
        # relative standard deviation of the focal length; infinite for a guess
        focal_deviation: float = 0.0,
    ) -> None:
        self.folder, self.camera = Path(folder), camera
        self._inputs = inputs or InputFiles()
        valid_outputs = check_outputs(outputs)
        # writes the files of a pair without the record
        self.files = PairFiles(
            folder=self.folder,
            outputs=valid_outputs,
            figures=figures if "figure" in valid_outputs else 0,
            has_pose=settings.motion != "field",
            disparity=disparity,
            screen=screen,
            focal_deviation=focal_deviation,
            inputs=self._inputs,
        )
        self._inputs.refuse(
            *(self.folder / name for name in (RECORD, TABLE, TIMINGS)),
            *(file for name in names for file in self.files.all(name)),
        )
        make_result_folder(folder)
        request = {
            "version": __version__,
            "arch": None,
            "lanes": None,
            "camera": asdict(camera),
            "source": None if source is None else _source_record(*source),
            "settings": asdict(settings),
            "window": window,
            "fixed_pixels": fixed_pixels,
            "outputs": list(valid_outputs),
            "figures": self.files.figures,
            "start": start,
            "step": step,
            # The parameters of anaglyphs matter only for runs with anaglyphs.
            "disparity": disparity if "anaglyph" in valid_outputs else None,
            "screen": screen if "anaglyph" in valid_outputs else None,
        }
        self._earlier: list[Path] = []
        self._record = RunRecord(self.folder, request, notes)
        self._contexts = ExitStack()
        self._resume = self._is_begun = resume
        self._has_report = True  # also if unknown

    def result_path(self, name: str) -> Path:
        """Return the file of a pair's interpretation."""
        return self.folder / f"{name}.npz"

    def is_complete(self, name: str, digest: str, number: int) -> bool:
        """Return whether an earlier run finished this pair, as in `RunRecord.is_complete`."""
        return self._record.is_complete(name, digest, self.files.endings(number))

    def has_pair(self, name: str) -> bool:
        """Return whether this run, or the run that it resumes, wrote a pair of this name."""
        return name in self._record.pairs

    def record_time(self, name: str, seconds: float) -> None:
        """Record the time of the interpretation of a pair, s."""
        self._record.record_time(name, seconds)

    def write(
        self, name: str, result: Interpretation, *, pose: np.ndarray | None = None, **arguments: Any
    ) -> None:
        """Write all files of a pair, as `PairFiles.write` does, and record it as finished.

        The first pair with depth sets the ranges of all pairs.
        """
        self.begin()
        self._remove_report()
        if self.ranges is None:
            has_unit = pose is not None
            self.ranges = Ranges.of(result, has_unit=has_unit, screen=self.files.screen)
        entry_and_checksums = self.files.write(
            name, result, ranges=self.ranges, pose=pose, **arguments
        )
        self._record.finish(name, *entry_and_checksums)

    def finish(self, name: str, entry: Mapping[str, Any], checksums: Checksums) -> None:
        """Record a pair as finished, with its entry; another process wrote its files."""
        self._remove_report()
        self._record.finish(name, entry, checksums)

    def begin(self) -> None:
        """Remove the files of an earlier run; the record is the last, since it names the files."""
        if self._is_begun:
            return
        self._is_begun = True
        self._inputs.refuse(*self._earlier)
        self._remove_report()
        records = (self.folder / name for name in (TABLE, TIMINGS, RECORD))
        for file in (*self._earlier, *records):
            file.unlink(missing_ok=True)

    def _remove_report(self) -> None:
        """Remove the report of an earlier command, once: this run makes the report outdated."""
        report, self._has_report = self._has_report, False
        if report and is_report(self.folder / REPORT):
            (self.folder / REPORT).unlink(missing_ok=True)

    @property
    def ranges(self) -> Ranges | None:
        """Ranges of values in images; None before the first pair with depth."""
        values = [self._record[key] for key in RANGE_KEYS]
        if any(value is None for value in values):
            return None
        return Ranges(**dict(zip(_RANGE_FIELDS, values, strict=True)))

    @ranges.setter
    def ranges(self, ranges: Ranges | None) -> None:
        for key, name in zip(RANGE_KEYS, _RANGE_FIELDS, strict=True):
            self._record[key] = None if ranges is None else getattr(ranges, name)

    def entries_between(self, first: int, end: int) -> dict[str, Mapping[str, Any]]:
        """Return the record's entries of pairs with these numbers, by their names."""
        return {
            name: pair for name, pair in self._record.pairs.items() if first <= pair["number"] < end
        }

    @property
    def statuses(self) -> Mapping[str, int]:
        """Number of finished pairs by status code, including pairs of a resumed run."""
        return {code: count for code, count in list(self._record.statuses.items()) if count}

    @property
    def grade_summary(self) -> GradeSummary | None:
        """The grades of finished pairs, the median and the worst; None without pairs."""
        return self._record.grade_summary

    @property
    def median_error(self) -> float:
        """Median of the expected relative errors of depth of finished pairs; NaN without depth.

        Contradicted pairs do not count.
        """
        errors = self._record.errors
        return upper_median(errors) if errors else math.nan

    @property
    def seconds(self) -> list[float]:
        """Times of the pairs that this command interpreted, s."""
        return list(self._record.seconds.values())

    @property
    def times_note(self) -> str:
        """The reason why a camera path cannot use the times of frames; "" without such a reason."""
        return self._record.times_note()

    @property
    def advice(self) -> dict[str, str]:
        """The message of the first pair of every status code other than ``"converged"``."""
        messages: dict[str, str] = {}
        for pair in self._record.pairs.values():
            if pair["status"] != "converged":
                messages.setdefault(pair["status"], pair["message"])
        return messages

    @property
    def focal_note(self) -> str:
        """How many converged pairs depend on the focal length, and why; "" without such pairs."""
        messages = [
            pair["message"] for pair in self._record.pairs.values() if pair["status"] == "converged"
        ]
        notes = [text[text.index(FOCAL_NOTE) :] for text in messages if FOCAL_NOTE in text]
        if not notes:
            return ""
        count = f"{len(notes)} of {len(messages)} converged pairs"
        return f"{count} depend on the focal length. Of the first: {notes[0]}"

    def expected_bytes(self, count: int) -> float:
        """Return the expected bytes of `count` pairs, from the first finished pair."""
        pair = next(iter(list(self._record.pairs.values())))
        lengths = {ending: length for ending, (length, _) in pair["files"].items()}
        figure = lengths.pop(ENDINGS["figure"], 0)
        figures = -(-count // self.files.figures) if self.files.figures else 0
        return float(sum(lengths.values()) * count + figure * figures)

    def __enter__(self) -> "PairWriter":
        with ExitStack() as stack:
            stack.enter_context(locked_folder(self.folder))
            runtime.start()
            self._record["arch"] = runtime.running_arch()
            self._record["lanes"] = runtime.lanes()
            self._earlier = self._record.read_earlier()
            if self._resume:
                self._record.resume()
            else:
                self._inputs.refuse(*self._earlier)
            self._contexts = stack.pop_all()
        return self

    def __exit__(self, *arguments: object) -> None:
        with self._contexts:
            self._inputs.refuse(*(self.folder / name for name in (RECORD, TABLE, TIMINGS)))
            self._record.write()


def _source_record(camera: Camera, shape: tuple[int, int]) -> dict[str, float]:
    """Return the size and the focal length of the source's frames, px, for the record."""
    return {"focal": camera.focal, "width": shape[1], "height": shape[0]}
