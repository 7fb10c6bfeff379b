"""The files that `tisfm run` and `tisfm demo` write for every pair."""

from collections.abc import Collection, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.cli.console import as_text
from tisfm.cli.motion_text import motion_rows, write_motions
from tisfm.cli.run_record import ENDINGS, RECORD, TABLE, TIMINGS, RunRecord
from tisfm.formats import (
    choose_depth_scale,
    write_depth_png,
    write_flo,
    write_png,
)
from tisfm.formats.folder_lock import locked_folder
from tisfm.formats.outputs import InputFiles, make_folder
from tisfm.interpretation import Interpretation
from tisfm.settings import Settings
from tisfm.show import (
    anaglyph,
    comparison_figure,
    depth_grey,
    flow_radius,
    inverse_depth_limit,
    rigid_figure,
    save_figure,
)
from tisfm.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

USUAL = tuple(output for output in ENDINGS if output not in ("flow", "ply"))
"""What is written by default: what is large and in the ``.npz`` as well is not."""


class PairWriter:
    """Writes interpretations into a folder, with one relative range and one depth scale for all.

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
    settings : Settings
    window : int
        How many frames an interpretation sees.
    outputs : collection of str
        What is written of a pair: the keys of `ENDINGS`.
    figures : int
        Figures are drawn of every so many pairs, from the first on; 0 for none.
    start, step : int
        The first frame of the source that is taken, and how many there are to the next.
    resume : bool
        Continue a run that was interrupted: keep its ranges and the pairs it finished.
    inputs : InputFiles
        Files that are not to be replaced.
    names : iterable of str
        Names of pairs to come, as far as they are known: their files are compared with `inputs`
        before anything is written, and all files once more when they are.

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
        window: int = 2,
        outputs: Collection[str] = USUAL,
        figures: int = 1,
        start: int = 0,
        step: int = 1,
        resume: bool = False,
        inputs: InputFiles | None = None,
        names: Iterable[str] = (),
    ) -> None:
        self.folder = Path(folder)
        self._outputs = checked_outputs(outputs)
        self._figures = figures if "figure" in self._outputs else 0
        self._inputs = inputs or InputFiles()
        self._inputs.refuse(
            *(self.folder / name for name in (RECORD, TABLE, TIMINGS)),
            *(file for name in names for file in self._files(name)),
        )
        make_folder(folder)
        asked = {
            "version": __version__,
            "arch": None,
            "camera": asdict(camera),
            "settings": asdict(settings),
            "window": window,
            "outputs": list(self._outputs),
            "figures": self._figures,
            "start": start,
            "step": step,
        }
        self._earlier: list[Path] = []
        self._has_pose = settings.motion != "field"
        self._record = RunRecord(self.folder, asked)
        self._with = ExitStack()
        self._resume = self._is_begun = resume

    def has_figure(self, number: int) -> bool:
        """Return whether the figure of a pair, by its number in the run, is drawn."""
        return bool(self._figures) and number % self._figures == 0

    def result_of(self, name: str) -> Path:
        """Return the file of a pair's interpretation."""
        return self.folder / f"{name}.npz"

    def is_complete(self, name: str, digest: str, number: int) -> bool:
        """Return whether an earlier run finished this pair, as `RunRecord.is_complete` says."""
        wanted = self._wanted(number)
        return self._record.is_complete(name, digest, [ENDINGS[output] for output in wanted])

    def knows(self, name: str) -> bool:
        """Return whether a pair of this name was written, by this run or the one continued."""
        return name in self._record.pairs

    def took(self, name: str, seconds: float) -> None:
        """Take down how long a pair was interpreted."""
        self._record.took(name, seconds)

    def write(
        self,
        name: str,
        result: Interpretation,
        *,
        number: int = 0,
        digest: str | None = None,
        times: tuple[float, float] | None = None,
        pose: np.ndarray | None = None,
        baseline_flow: np.ndarray | None = None,
        truth_flow: np.ndarray | None = None,
        truth_inverse_depth: np.ndarray | None = None,
    ) -> None:
        """Write all files of a pair.

        Parameters
        ----------
        name : str
            Beginning of the file names.
        result : Interpretation
        number : int
            Of the pair in the run, by which it has a figure or not.
        digest : str, optional
            Hash of the pair's frames and pose, for `is_complete`.
        times : (float, float), optional
            When its frames were taken, s.
        pose : (4, 4), optional
            The motion that the interpretation was given: depth has its unit, the same in all
            pairs.
        baseline_flow : (H, W, 2), optional
            Horn and Schunck's flow, for the figure of ``motion="field"``.
        truth_flow : (H, W, 2), optional
            The true flow, for the figure.
        truth_inverse_depth : (H, W), optional
            The true inverse depth, for the figure.

        Raises
        ------
        OSError
            If a file cannot be written.
        ValueError
            If one of them is an input.
        """
        if not self._is_begun:
            self._remove_earlier()
        limit = self._limit(result, pose)
        scale = self._record["depth16_values_per_unit"] or 1.0
        self._inputs.refuse(*self._files(name))
        path = self.folder / name
        # Until all is rewritten, an .npz of an earlier run must not mark the pair as complete.
        Path(f"{path}.npz").unlink(missing_ok=True)
        motions = motion_rows(result, pose=pose)
        wanted = self._wanted(number)
        if "depth16" in wanted:
            write_depth_png(f"{path}_depth16.png", result.depth, scale=scale)
        if "depth" in wanted:
            write_png(f"{path}_depth.png", depth_grey(result.inverse_depth, limit=limit))
        if "flow" in wanted:
            write_flo(f"{path}_flow.flo", result.flow)
        if "anaglyph" in wanted:
            picture = anaglyph(result.frame, result.inverse_depth, limit=limit)
            write_png(f"{path}_anaglyph.png", picture)
        if "figure" in wanted:
            figure = _figure(
                as_text(name),
                result,
                baseline_flow=baseline_flow,
                depth_limit=limit,
                flow_limit=self._record["flow_limit"],
                truth_flow=truth_flow,
                truth_inverse_depth=truth_inverse_depth,
            )
            save_figure(f"{path}_figure.png", figure)
        if "ply" in wanted:
            result.points().save(f"{path}.ply")
        if "pose" in wanted and motions is not None:
            write_motions(f"{path}_pose.txt", motions)
        if "npz" in wanted:
            result.save(f"{path}.npz", compact=True)
        about = {
            "status": str(result.status),
            "message": result.status.message,
            "motions": _finite_list(motions),
            "frames": digest,
            "times": times,
            **_summary(result),
        }
        self._record.finish(name, about, [ENDINGS[output] for output in wanted])

    def _limit(self, result: Interpretation, pose: np.ndarray | None) -> float | None:
        """Return the inverse depth that is shown brightest; the first that moves sets the ranges.

        They are one for a whole sequence, so that nothing flickers.
        """
        record = self._record
        wrong = result.status in ("diverged", "pose_mismatch")
        if wrong or not (result.inverse_depth > 0).any():
            return None
        # Each pair has a scale of its own, ‖T‖ = 1, which is taken out first: a camera that speeds
        # up would make everything brighter. Not so with known poses.
        level = 1.0 if pose is not None else _mean_inverse_depth(result)
        if record["depth_range"] is None:
            record["depth_range"] = inverse_depth_limit(result.inverse_depth) / level
            record["depth16_values_per_unit"] = choose_depth_scale(result.depth)
            record["flow_limit"] = float(np.percentile(flow_radius(result.flow), 99))
        return float(record["depth_range"] * level)

    def _wanted(self, number: int) -> list[str]:
        """Return what is written of a pair, by its number in the run."""
        left_out = set() if self.has_figure(number) else {"figure"}
        left_out |= set() if self._has_pose else {"pose"}
        return [output for output in self._outputs if output not in left_out]

    def _remove_earlier(self) -> None:
        """Remove what an earlier run wrote here, its record last: until then it can be told."""
        self._is_begun = True
        self._inputs.refuse(*self._earlier)
        for file in (*self._earlier, *(self.folder / name for name in (TABLE, TIMINGS, RECORD))):
            file.unlink(missing_ok=True)

    @property
    def statuses(self) -> Mapping[str, int]:
        """How many pairs have which status code so far, those of a resumed run included."""
        return {code: count for code, count in list(self._record.statuses.items()) if count}

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
        figures = -(-count // self._figures) if self._figures else 0
        return float(sum(lengths.values()) * count + figure * figures)

    def _files(self, name: str) -> list[Path]:
        """Return the files that a pair may have."""
        return [self.folder / f"{name}{ending}" for ending in ENDINGS.values()]

    def __enter__(self) -> "PairWriter":
        with ExitStack() as opened:
            opened.enter_context(locked_folder(self.folder))
            runtime.start()
            self._record["arch"] = runtime.running_arch()
            self._earlier = self._record.look()
            if self._resume:
                self._record.resume()
            else:
                self._inputs.refuse(*self._earlier)
            self._with = opened.pop_all()
        return self

    def __exit__(self, *about: object) -> None:
        with self._with:
            self.write_record()

    def write_record(self) -> None:
        """Write the record of what is finished."""
        self._inputs.refuse(*(self.folder / name for name in (RECORD, TABLE, TIMINGS)))
        self._record.write()


def checked_outputs(outputs: Collection[str]) -> tuple[str, ...]:
    """Return outputs in the order in which they are written, or raise ValueError."""
    unknown = sorted(set(outputs) - set(ENDINGS))
    if unknown or not outputs:
        what = f"{unknown[0]!r} is none" if unknown else "there are none"
        raise ValueError(f"outputs: {what}: expected some of {', '.join(ENDINGS)}")
    return tuple(output for output in ENDINGS if output in outputs)


def _summary(result: Interpretation) -> dict[str, Any]:
    """Return what the table of a run says of a pair beside its status."""
    speed = np.sqrt((result.flow.astype(np.float64) ** 2).sum(axis=-1))
    return {
        "speed": _rounded(speed[np.isfinite(speed)].mean()) if np.isfinite(speed).any() else None,
        "occluded": _rounded(result.occlusion.mean()),
        "confidence": _rounded(result.confidence.mean(dtype=np.float64)),
        "twists": _finite_list(result.motions),
    }


def _rounded(value: float) -> float | None:
    """Return a number with six digits; it is for reading."""
    return float(f"{value:.6g}") if np.isfinite(value) else None


def _figure(
    name: str, result: Interpretation, *, baseline_flow: np.ndarray | None, **shown: Any
) -> "Figure":
    """Draw what suits the motion model; `shown` are truth and limits, the same for all."""
    arrays = result.frame, result.inverse_depth, result.flow
    if result.motions is None or result.inverse_depth_std is None:
        return comparison_figure(
            *arrays, occlusion=result.occlusion, baseline_flow=baseline_flow, title=name, **shown
        )
    return rigid_figure(
        *arrays,
        inverse_depth_std=result.inverse_depth_std,
        confidence=result.confidence,
        labels=result.labels,
        occlusion=result.occlusion,
        title=name if result.status == "converged" else f"{name} ({result.status})",
        **shown,
    )


def _mean_inverse_depth(result: Interpretation) -> float:
    """Return the mean inverse depth, in which what is no depth counts as infinitely far."""
    mean = np.maximum(result.inverse_depth, 0).mean(dtype=np.float64)
    return float(f"{mean:.9g}")  # how NumPy adds up depends on where an array lies in memory


def _finite_list(numbers: np.ndarray | None) -> list[Any] | None:
    """Return numbers as JSON can hold them; it has no NaN."""
    return None if numbers is None or not np.isfinite(numbers).all() else numbers.tolist()
