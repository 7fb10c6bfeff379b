"""The files that `tisfm run` and `tisfm demo` write for every pair."""

import json
import math
import time
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from tisfm.camera import Camera
from tisfm.cli.motion_text import motion_rows, write_motions
from tisfm.formats import (
    atomic_write,
    choose_depth_scale,
    write_depth_png,
    write_flo,
    write_png,
)
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

RECORD = "run.json"
_RENEWED = 1.0  # s: the record of a long run takes longer to write than a pair
ENDINGS = (
    "_depth16.png", "_depth.png", "_flow.flo", "_anaglyph.png", "_figure.png", ".ply", "_pose.txt",
    ".npz",
)  # fmt: skip
"""What names of a pair's files end in."""


class PairWriter:
    """Writes interpretations into a folder, with one relative range and one depth scale for all.

    For a pair named ``name``: ``name_depth16.png`` (16-bit depth, its scale written in the file
    and in the record), ``name_depth.png`` (grey levels, near is bright), ``name_flow.flo``,
    ``name_anaglyph.png``, ``name_figure.png``, ``name.ply``, of rigid motions ``name_pose.txt``,
    and last ``name.npz``, which therefore marks a complete pair. The record, ``run.json``, holds
    settings, camera, ranges, and of every finished pair its status, its rigid motions and a hash
    of its frames. It is renewed after a pair where the last time was a second ago, and when the
    writer, which is a context manager, is left. A pair that is not in the record is not complete.

    Parameters
    ----------
    folder : path
        Made if it does not exist.
    camera : Camera
    settings : Settings
    window : int
        How many frames an interpretation sees.
    figures : bool
        Whether to draw the figure.
    ply : bool
        Whether to write the point cloud.
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
        If the folder cannot be made or written to.
    ValueError
        If a file to be written is one of `inputs`, or if `resume` is set and the folder holds a
        run with another camera or other options.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        camera: Camera,
        settings: Settings,
        window: int = 2,
        figures: bool = True,
        ply: bool = False,
        resume: bool = False,
        inputs: InputFiles | None = None,
        names: Iterable[str] = (),
    ) -> None:
        self.folder = Path(folder)
        self._inputs = inputs or InputFiles()
        self._inputs.refuse(
            self.folder / RECORD, *(file for name in names for file in self._files(name))
        )
        make_folder(folder)
        self._record: dict[str, Any] = {
            "version": __version__,
            "camera": asdict(camera),
            "settings": asdict(settings),
            "window": window,
            "figures": figures,
            "ply": ply,
            "depth16_values_per_unit": None,
            "depth_range": None,
            "flow_limit": None,
            "pairs": {},
        }
        self._renewed, self._recorded = -math.inf, True
        if resume:
            self._continue()

    @property
    def figures(self) -> bool:
        """Whether figures are drawn."""
        return bool(self._record["figures"])

    def result_of(self, name: str) -> Path:
        """Return the file of a pair's interpretation."""
        return self.folder / f"{name}.npz"

    def knows(self, name: str) -> bool:
        """Return whether a pair of this name was written, by this run or the one continued."""
        return name in self._record["pairs"]

    def is_complete(self, name: str, digest: str) -> bool:
        """Return whether an earlier run finished this pair.

        Parameters
        ----------
        name : str
        digest : str
            Hash of the pair's frames, and of its pose and masks if those were given.

        Raises
        ------
        ValueError
            If it finished a pair of this name, but of other frames, or with another pose or mask.
        """
        pair = self._record["pairs"].get(name)
        if pair is None or not (self.folder / f"{name}.npz").is_file():
            return False
        if pair["frames"] != digest:
            raise ValueError(
                f"{self.folder} holds a run in which {name} was another pair of frames, or had "
                "another pose or mask: give the same frames and step again, and the same poses and "
                "masks, or run without --resume to start again"
            )
        return True

    def write(
        self,
        name: str,
        result: Interpretation,
        *,
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
        record = self._record
        wrong = result.status in ("diverged", "pose_mismatch")
        usable = not wrong and bool((result.inverse_depth > 0).any())
        # Each pair has a scale of its own, ‖T‖ = 1, which is taken out first: a camera that speeds
        # up would make everything brighter. Not so with known poses.
        level = 1.0 if pose is not None else _mean_inverse_depth(result) if usable else 0.0
        if usable and record["depth_range"] is None:
            # The first pair that moves sets the ranges: one for a whole sequence, no flicker.
            record["depth_range"] = inverse_depth_limit(result.inverse_depth) / level
            record["depth16_values_per_unit"] = choose_depth_scale(result.depth)
            record["flow_limit"] = float(np.percentile(flow_radius(result.flow), 99))
        limit = record["depth_range"] * level if usable else None
        scale = record["depth16_values_per_unit"] or 1.0
        self._inputs.refuse(*self._files(name))
        path = self.folder / name
        # Until all is rewritten, an .npz of an earlier run must not mark the pair as complete.
        Path(f"{path}.npz").unlink(missing_ok=True)
        write_depth_png(f"{path}_depth16.png", result.depth, scale=scale)
        write_png(f"{path}_depth.png", depth_grey(result.inverse_depth, limit=limit))
        write_flo(f"{path}_flow.flo", result.flow)
        write_png(f"{path}_anaglyph.png", anaglyph(result.frame, result.inverse_depth, limit=limit))
        if self.figures:
            figure = _figure(
                name,
                result,
                baseline_flow=baseline_flow,
                depth_limit=limit,
                flow_limit=record["flow_limit"],
                truth_flow=truth_flow,
                truth_inverse_depth=truth_inverse_depth,
            )
            save_figure(f"{path}_figure.png", figure)
        if record["ply"]:
            result.points().save(f"{path}.ply")
        motions = motion_rows(result, pose=pose)
        if motions is not None:
            write_motions(f"{path}_pose.txt", motions)
        result.save(f"{path}.npz")
        self._recorded = False
        record["pairs"][name] = {
            "status": str(result.status),
            "message": result.status.message,
            "motions": _finite_list(motions),
            "frames": digest,
            "times": times,
        }
        if time.monotonic() - self._renewed > _RENEWED:
            self.write_record()

    @property
    def statuses(self) -> list[str]:
        """Status codes of the pairs written so far, those of a resumed run included."""
        return [pair["status"] for pair in self._record["pairs"].values()]

    @property
    def advice(self) -> dict[str, str]:
        """The message of the first pair of every status code other than ``"converged"``."""
        messages: dict[str, str] = {}
        for pair in self._record["pairs"].values():
            if pair["status"] != "converged":
                messages.setdefault(pair["status"], pair["message"])
        return messages

    def _continue(self) -> None:
        path = self.folder / RECORD
        if not path.is_file():
            return
        try:
            before = json.loads(path.read_text(encoding="utf-8"))
            before.setdefault("window", 2)  # records of versions that had pairs alone
            same = all(
                before[key] == json.loads(json.dumps(self._record[key]))
                for key in ("version", "camera", "settings", "window", "figures", "ply")
            )
            missing = set(self._record) - set(before)
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            raise ValueError(f"{path} is damaged ({error}): run without --resume") from error
        if missing or not same:
            raise ValueError(
                f"{self.folder} holds a run with another camera, other settings or outputs, or "
                "of another version: repeat its options, or run without --resume to start again"
            )
        self._record = before

    def _files(self, name: str) -> list[Path]:
        """Return the files that a pair may have."""
        return [self.folder / f"{name}{ending}" for ending in ENDINGS]

    def __enter__(self) -> "PairWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if not self._recorded:
            self.write_record()

    def write_record(self) -> None:
        """Write the record of what is finished."""
        self._inputs.refuse(self.folder / RECORD)
        text = json.dumps(self._record, indent=2, ensure_ascii=False) + "\n"
        with atomic_write(self.folder / RECORD) as file:
            file.write(text.encode("utf-8"))
        self._renewed, self._recorded = time.monotonic(), True


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
    return float(np.maximum(result.inverse_depth, 0).mean())


def _finite_list(numbers: np.ndarray | None) -> list[Any] | None:
    """Return numbers as JSON can hold them; it has no NaN."""
    return None if numbers is None or not np.isfinite(numbers).all() else numbers.tolist()
