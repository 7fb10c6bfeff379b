"""The files of one pair, as `tisfm run` and `tisfm demo` write them."""

import math
import os
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tisfm.checks import spelling_hint
from tisfm.errors import InputError
from tisfm.folders.files import file_checksum
from tisfm.folders.result_folder import InputFiles
from tisfm.folders.run_record import ENDINGS
from tisfm.formats import atomic_write, choose_depth_scale, write_depth_png, write_flo, write_png
from tisfm.interpretation import Interpretation
from tisfm.machine.text import printable
from tisfm.rigid import rigid_motion
from tisfm.show import (
    anaglyph,
    comparison_figure,
    depth_grey,
    inverse_depth_limit,
    rigid_figure,
    save_figure,
    usual_length,
)
from tisfm.show.stereo import DISPARITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure


DEFAULT_OUTPUTS = tuple(output for output in ENDINGS if output not in ("flow", "ply"))
"""Default outputs: all except large files whose content is also in the ``.npz``."""

Checksums = dict[str, tuple[int, int]]  # length, bytes, and CRC-32 of files, by their endings


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """Ranges of values in images, common to a whole sequence, so that images do not flicker."""

    # the inverse depth with the brightest grey, in multiples of the mean inverse depth of the pair,
    # or, if the user gave poses, in 1/unit of the poses
    depth: float
    depth16: float  # values of a 16-bit image per unit of depth
    flow: float  # the speed with the strongest colour, px/frame
    screen: float  # the inverse depth of the screen plane of anaglyphs, in the unit of `depth`

    @classmethod
    def of(
        cls, result: Interpretation, *, has_unit: bool, screen: float | None = None
    ) -> "Ranges | None":
        """Return the ranges of the values of a pair; None without depth.

        `screen` is the quantile of depth at the screen plane. By default the inverse depth of this
        plane is half of the brightest inverse depth.
        """
        if not has_drawable_depth(result):
            return None
        unit = _depth_unit(result, has_unit)
        depth = inverse_depth_limit(result.inverse_depth) / unit
        screen_inverse = depth / 2
        if screen is not None:
            depths = result.inverse_depth[result.inverse_depth > 0]
            screen_inverse = float(np.quantile(depths, screen)) / unit
        return cls(
            depth=depth,
            depth16=choose_depth_scale(result.depth),
            flow=usual_length(result.flow),
            screen=screen_inverse,
        )

    def depth_limit(self, result: Interpretation, *, has_unit: bool) -> float | None:
        """Return the inverse depth with the brightest grey in a pair; None without depth."""
        if not has_drawable_depth(result):
            return None
        return float(self.depth * _depth_unit(result, has_unit))

    def screen_depth(self, result: Interpretation, *, has_unit: bool) -> float | None:
        """Return the depth of the screen plane in a pair; None without depth."""
        if not has_drawable_depth(result):
            return None
        screen_inverse = self.screen * _depth_unit(result, has_unit)
        return 1 / screen_inverse if screen_inverse > 0 else math.inf


def has_drawable_depth(result: Interpretation) -> bool:
    """Return whether a pair has depth that may be drawn."""
    is_wrong = result.status in ("diverged", "pose_mismatch")
    return not is_wrong and bool((result.inverse_depth > 0).any())


@dataclass(frozen=True, kw_only=True)
class PairFiles:
    """The files of pairs in a folder, and their writing."""

    folder: Path
    outputs: tuple[str, ...]  # the outputs of a pair: keys of `ENDINGS`
    figures: int  # interval of pairs with a figure; 0 for no figures
    has_pose: bool  # whether interpretations have rigid motions
    # disparity, screen: parameters of anaglyphs: the disparity range as a share of the width, and
    # the quantile of depth at the screen plane, in the first pair with depth
    disparity: float = DISPARITY
    screen: float | None = None
    # relative standard deviation of the focal length; infinite for a guess
    focal_deviation: float = 0.0
    # files that no result may replace
    inputs: InputFiles = field(default_factory=InputFiles, repr=False)

    def has_figure(self, number: int) -> bool:
        """Return whether a pair, by its number in the run, has a figure."""
        return bool(self.figures) and number % self.figures == 0

    def endings(self, number: int) -> list[str]:
        """Return the endings of the files of a pair, by its number in the run."""
        return [ENDINGS[output] for output in self._outputs_of(number)]

    def all(self, name: str) -> list[Path]:
        """Return all files that a pair may have."""
        return [self.folder / f"{name}{ending}" for ending in ENDINGS.values()]

    def write(
        self,
        name: str,  # beginning of the file names
        result: Interpretation,
        *,
        ranges: Ranges | None,  # None before the first pair with depth
        number: int = 0,  # number of the pair in the run; it decides whether the pair has a figure
        digest: str | None = None,  # hash of the pair's frames and pose
        times: tuple[float, float] | None = None,  # times of the pair's frames, s
        # (4, 4): the motion that the interpretation used. Then depth has the unit of the poses, the
        # same in all pairs.
        pose: np.ndarray | None = None,
        # (H, W, 2): flow of Horn and Schunck, for the figure of ``motion="field"``
        baseline_flow: np.ndarray | None = None,
        truth_flow: np.ndarray | None = None,  # (H, W, 2): the true flow, for the figure
        # (H, W): the true inverse depth, for the figure
        truth_inverse_depth: np.ndarray | None = None,
    ) -> tuple[dict[str, Any], Checksums]:
        """Write all files of a pair; return the record's entry of the pair, and check sums.

        Raises OSError if a file cannot be written.

        Raises ValueError if a file is an input.
        """
        result = replace(result, focal_deviation=self.focal_deviation)
        depth_limit = (
            None if ranges is None else ranges.depth_limit(result, has_unit=pose is not None)
        )
        self.inputs.refuse(*self.all(name))
        path = self.folder / name
        # Until all files are rewritten, the .npz of an earlier run must not mark the pair as
        # complete.
        Path(f"{path}.npz").unlink(missing_ok=True)
        motions = motion_rows(result, pose=pose)
        outputs = self._outputs_of(number)
        if "depth16" in outputs:
            scale = 1.0 if ranges is None else ranges.depth16
            write_depth_png(f"{path}_depth16.png", result.depth, scale=scale)
        if "depth" in outputs:
            write_png(f"{path}_depth.png", depth_grey(result.inverse_depth, limit=depth_limit))
        if "flow" in outputs:
            write_flo(f"{path}_flow.flo", result.flow)
        if "anaglyph" in outputs:
            has_unit = pose is not None
            picture = anaglyph(
                result.frame,
                result.inverse_depth,
                disparity=self.disparity,
                screen_depth=None
                if ranges is None
                else ranges.screen_depth(result, has_unit=has_unit),
                limit=depth_limit,
            )
            write_png(f"{path}_anaglyph.png", picture)
        if "figure" in outputs:
            figure = _figure(
                printable(name),
                result,
                baseline_flow=baseline_flow,
                depth_limit=depth_limit,
                flow_limit=None if ranges is None else ranges.flow,
                unit="relative" if pose is None else "unit of the poses",
                truth_flow=truth_flow,
                truth_inverse_depth=truth_inverse_depth,
            )
            save_figure(f"{path}_figure.png", figure)
        if "ply" in outputs:
            result.points().save(f"{path}.ply")
        if "pose" in outputs and motions is not None:
            write_motions(f"{path}_pose.txt", motions)
        if "npz" in outputs:
            result.save(f"{path}.npz", compact=True)
        entry = {
            "number": number,
            "status": str(result.status),
            "message": result.status.message,
            "motions": _finite_list(motions),
            "frames": digest,
            "times": times,
            **_summary(result),
        }
        files = {
            ending: file_checksum(self.folder / f"{name}{ending}")
            for ending in self.endings(number)
        }
        missing_endings = [ending for ending, checksum in files.items() if checksum is None]
        if missing_endings:
            raise OSError(f"{path}{missing_endings[0]} was removed during the run: run again")
        return entry, {
            ending: checksum for ending, checksum in files.items() if checksum is not None
        }

    def _outputs_of(self, number: int) -> list[str]:
        """Return the outputs of a pair, by its number in the run."""
        excluded = set() if self.has_figure(number) else {"figure"}
        excluded |= set() if self.has_pose else {"pose"}
        return [output for output in self.outputs if output not in excluded]


def check_outputs(outputs: Collection[str]) -> tuple[str, ...]:
    """Return outputs in the order of their writing; ValueError for unknown outputs."""
    unknown = sorted(set(outputs) - set(ENDINGS))
    if unknown or not outputs:
        fault = "no output is given"
        if unknown:
            fault = f"{unknown[0]!r} is not an output{spelling_hint(unknown[0], ENDINGS)}"
        raise InputError(f"outputs: {fault}: expected some of {', '.join(ENDINGS)}")
    return tuple(output for output in ENDINGS if output in outputs)


def _summary(result: Interpretation) -> dict[str, Any]:
    """Return the values of a pair, except its status, for the table of a run."""
    with np.errstate(over="ignore"):
        speed = np.sqrt(result.flow[..., 0] ** 2 + result.flow[..., 1] ** 2)
    is_finite = np.isfinite(speed)
    mean_speed = np.mean(speed, where=is_finite, dtype=np.float64) if is_finite.any() else np.nan
    return {
        "grade": str(result.grade),
        "depth_error": _round(result.depth_error),
        "speed": _round(float(mean_speed)),
        "occluded": _round(np.count_nonzero(result.occlusion) / result.occlusion.size),
        "confidence": _round(result.confidence.mean(dtype=np.float64)),
        "twists": _finite_list(result.motions),
    }


def _round(value: float) -> float | None:
    """Return a number with six significant digits, for a reader; None if it is not finite."""
    return float(f"{value:.6g}") if np.isfinite(value) else None


def _figure(
    name: str, result: Interpretation, *, baseline_flow: np.ndarray | None, **options: Any
) -> "Figure":
    """Draw the figure for the motion model; `options` has the truth and the limits."""
    arrays = result.frame, result.inverse_depth, result.flow
    if result.motions is None or result.inverse_depth_std is None:
        return comparison_figure(
            *arrays, occlusion=result.occlusion, baseline_flow=baseline_flow, title=name, **options
        )
    return rigid_figure(
        *arrays,
        inverse_depth_std=result.inverse_depth_std,
        confidence=result.confidence,
        labels=result.labels,
        occlusion=result.occlusion,
        title=name if result.status == "converged" else f"{name} ({result.status})",
        **options,
    )


def _depth_unit(result: Interpretation, has_unit: bool) -> float:
    """Return the unit in which inverse depth is shown.

    Each pair has its own scale, ‖T‖ = 1, so images would get brighter if the camera speeds up.
    Division by the mean inverse depth removes this scale; pixels without depth have the inverse
    depth 0. With known poses the unit is 1.
    """
    if has_unit:
        return 1.0
    mean = np.maximum(result.inverse_depth, 0).mean(dtype=np.float64)
    return float(f"{mean:.9g}")  # rounding of NumPy's sum depends on the address of the array


def _finite_list(numbers: np.ndarray | None) -> list[Any] | None:
    """Return numbers as JSON values; None if any number is not finite."""
    return None if numbers is None or not np.isfinite(numbers).all() else numbers.tolist()


def motion_rows(
    result: Interpretation,
    *,
    # (4, 4): the motion that the interpretation used. It replaces the first motion, since
    # `Interpretation.motions` does not have the length of the translation.
    pose: np.ndarray | None = None,
) -> np.ndarray | None:
    """Return the rigid motions of a result as rows of numbers.

    Returns (K, 12) float64, or None for ``motion="field"``. Each row has the three rows of (R |
    t): P₁ = R P₀ + t, with t in the unit of `Interpretation.depth`; NaN where the interpretation
    diverged.
    """
    if result.motions is None:
        return None
    rows = np.full((len(result.motions), 12), np.nan)
    for row, twist in zip(rows, result.motions, strict=True):
        if np.isfinite(twist).all():
            rotation, translation = rigid_motion(twist)
            row[:] = np.column_stack([rotation, translation]).ravel()
    if pose is not None:
        rows[0] = np.asarray(pose, np.float64)[:3].ravel()
    return rows


def write_motions(
    path: str | os.PathLike[str],
    rows: np.ndarray,  # (K, 12)
) -> None:
    """Write motions as text, atomically: a line of twelve numbers for each motion.

    Raises OSError if the file cannot be written.
    """
    lines = (" ".join(f"{number:.9g}" for number in row) for row in rows)
    with atomic_write(path) as file:
        file.write("".join(f"{line}\n" for line in lines).encode("ascii"))
