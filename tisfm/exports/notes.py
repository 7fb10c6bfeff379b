"""Notes on an export: what it left out, and what it had to assume."""

import numpy as np

from tisfm.exports.camera_path import is_centered
from tisfm.exports.chosen_frames import FRAME_RATE, pieces_of
from tisfm.exports.export_request import ExportRequest, source_camera
from tisfm.exports.frame_maps import (
    MAX_VALUE,
    VALUES_PER_UNIT,
    DepthKind,
    check_fits,
    frames_with_depth,
)
from tisfm.focal_guess import at_size
from tisfm.results.pair_frames import PairFrames
from tisfm.status import STATUSES
from tisfm.trajectory.times import are_increasing


def note_poses(export: ExportRequest) -> list[str]:
    """Note frames without a pose, and several pieces."""
    pieces = pieces_of(export.sequence, export.chosen)
    without = len(export.chosen) - sum(map(len, pieces))
    notes = [f"{_frames(without)} without a pose left out"] if without else []
    if len(pieces) > 1:
        sizes = ", ".join(str(len(piece)) for piece in pieces)
        notes.append(
            f"{len(pieces)} pieces ({sizes} frames), each with its own scale and its own file"
        )
    return notes


def note_models(export: ExportRequest) -> list[str]:
    """Note frames without a model: without a pose, or in a piece of one frame."""
    pieces = [piece for piece in pieces_of(export.sequence, export.chosen) if len(piece) > 1]
    notes = []
    if without := len(export.chosen) - sum(map(len, pieces)):
        notes.append(f"{_frames(without)} without a pose, or in a piece of one frame, left out")
    if len(pieces) > 1:
        sizes = ", ".join(str(len(piece)) for piece in pieces)
        notes.append(
            f"{len(pieces)} pieces ({sizes} frames), each with its own scale and its own model"
        )
    return notes


def note_largest(export: ExportRequest) -> list[str]:
    """Note frames outside the largest piece."""
    largest = max(map(len, pieces_of(export.sequence, export.chosen)))
    without = len(export.chosen) - largest
    return [f"only the largest piece; {_frames(without)} left out"] if without else []


def note_times(export: ExportRequest) -> list[str]:
    """Note that frame numbers replace times."""
    if are_increasing(export.frames.times) or export.frames_per_second is not None:
        return []
    return [f"{_without(export)}: frame numbers replace seconds; --fps sets the frames per second"]


def note_rate(export: ExportRequest) -> list[str]:
    """Note that the frame rate is a guess."""
    known = are_increasing([export.frames.times[frame] for frame in export.chosen])
    if (known and len(export.chosen) > 1) or export.frames_per_second is not None:
        return []
    return [f"{_without(export)}: {FRAME_RATE:g} per second are assumed; --fps sets another rate"]


def note_lens(export: ExportRequest) -> list[str]:
    """Note a principal point outside the middle, which the format cannot store."""
    result = export.sequence
    if is_centered(result.camera, result.shape):
        return []
    cx, cy = result.camera.center_for(*result.shape)
    size = at_size(result.shape)
    return [
        f"the principal point is at ({cx:.1f}, {cy:.1f}) px{size}, not in the middle: the file "
        "cannot store it; set the lens shift from lens.json"
    ]


def note_shutter(export: ExportRequest) -> list[str]:
    """Note that the maps do not undo a rolling shutter."""
    if not source_camera(export)[0].readout:
        return []
    return ["the maps do not correct the rolling shutter; the frames of the result are corrected"]


def note_depth(export: ExportRequest) -> list[str]:
    """Note frames without depth, and statuses that this version does not know."""
    shown = frames_with_depth(export.frames, export.chosen)
    without = len(export.chosen) - len(shown)
    notes = [f"{_frames(without)} without depth left out"] if without else []
    statuses = [export.frames.statuses[frame] for frame in shown]
    codes = [str(status) for status in statuses if status not in STATUSES]
    if codes:
        notes.append(
            f"{_frames(len(codes))} with a status that this version does not know "
            f"({', '.join(sorted(set(codes)))}): treat their depth as doubtful"
        )
    return notes


def note_scale(export: ExportRequest, kind: DepthKind) -> list[str]:
    """Note the scale of 16-bit depth, and the share of depth beyond its range."""
    scale = VALUES_PER_UNIT[kind]
    beyond = check_fits(export.frames, frames_with_depth(export.frames, export.chosen), kind)
    unit = "the unit of the path"
    if isinstance(export.frames, PairFrames):
        unit = "the unit of the poses" if export.frames.has_one_scale else "the unit of each pair"
    notes = [f"depth is value / {scale:g}, in {unit}"]
    if beyond:
        notes.append(
            f"about {np.ceil(1000 * beyond) / 10:g} % of it is beyond {MAX_VALUE / scale:.4g}, "
            "and 0 in the files"
        )
    return notes


def _without(export: ExportRequest) -> str:
    """Return why the times of the frames are not used."""
    if any(export.frames.times[frame] is None for frame in export.chosen):
        return "frames have no times"
    return "frames have no times that rise"


def _frames(count: int) -> str:
    return f"{count} frame{'s' * (count != 1)}"
