"""Reconstructions of sequences, compared with a known path or depth."""

import time
from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tisfm
from tisfm.camera import Camera
from tisfm.datasets import DatasetSequence, LoadedSequence
from tisfm.errors import InputError
from tisfm.evaluation.sequence_depth import SequenceDepthErrors, sequence_depth_errors
from tisfm.evaluation.sequence_result import SequenceResult
from tisfm.metrics import (
    AbsoluteErrors,
    Drift,
    RelativeErrors,
    absolute_errors,
    drift,
    path_length,
    relative_errors,
)
from tisfm.reconstruction.stages.progress import Progress
from tisfm.settings import Settings

LONG_STEP = 10  # frames: distance for `relative_step`; set by hand
MIN_POSES = 3  # poses of a piece: an alignment fits fewer poses exactly


@dataclass(frozen=True, kw_only=True)
class PieceErrors:
    """Errors of the poses of one piece.

    Attributes
    ----------
    piece : int
    frames : int
        Frames with a pose in the piece.
    absolute : AbsoluteErrors or None
        None if fewer than 3 of these frames have a true pose, or if the camera only turns: then
        positions are unknown, and all errors are None.
    share : float or None
        `absolute.similarity` over the length of the true path of the whole sequence; None for a
        static camera.
    rigid_share : float or None
        `absolute.rigid` over the same length.
    relative, relative_step : RelativeErrors or None
        Errors of the motion from each frame to the next, and to the tenth frame after it, in the
        scale of the alignment.
    drift : Drift or None
        In the same scale.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.datasets import find_sequences
    >>> from tisfm.evaluation import compare_sequence
    >>> (sequence,) = find_sequences("calibrated")
    >>> result = tisfm.Reconstruction.load("walk")
    >>> errors = compare_sequence(sequence, sequence.load(), result, camera=result.camera)
    >>> piece = errors.pieces[0]
    >>> piece.frames, piece.share < 0.05  # of the length of the path
    (9, True)
    """

    piece: int
    frames: int
    absolute: AbsoluteErrors | None = None
    share: float | None = None
    rigid_share: float | None = None
    relative: RelativeErrors | None = None
    relative_step: RelativeErrors | None = None
    drift: Drift | None = None


@dataclass(frozen=True, kw_only=True)
class SequenceEvaluation:
    """The errors of one sequence, or the reason why there are none.

    Attributes
    ----------
    sequence : DatasetSequence
    step : int
        Step of the evaluated frames.
    fault : str or None
        The reason why the sequence has no errors, in one line; None if it was evaluated.
    frames, posed : int
        Numbers of frames, and of frames with a pose.
    path : float or None
        Length of the true path, m; None if it is unknown.
    pieces : tuple of PieceErrors
        The largest first.
    depth : SequenceDepthErrors or None
        None without a true depth, or without depth to compare.
    poses_given : bool
    seconds : float or None
        Time of the reconstruction; None for a result from a file.
    statuses : dict
        Number of frames by status.

    Examples
    --------
    >>> from tisfm.datasets import find_sequences
    >>> from tisfm.evaluation import SequenceEvaluation
    >>> (sequence,) = find_sequences("calibrated")
    >>> record = SequenceEvaluation(sequence=sequence, fault="the file is damaged")
    >>> record.largest_share  # of the frames: there is no path
    0.0
    """

    sequence: DatasetSequence
    step: int = 1
    fault: str | None = None
    frames: int = 0
    posed: int = 0
    path: float | None = None
    pieces: tuple[PieceErrors, ...] = ()
    depth: SequenceDepthErrors | None = None
    poses_given: bool = False
    seconds: float | None = None
    statuses: dict[str, int] | None = None

    @property
    def largest_share(self) -> float:
        """Share of the frames that are in the largest piece."""
        return self.pieces[0].frames / self.frames if self.pieces else 0.0


def compare_sequence(
    sequence: DatasetSequence,
    loaded: LoadedSequence,
    result: SequenceResult,
    *,
    camera: Camera,
    step: int = 1,
    poses_given: bool = False,
    max_depth: float | None = None,
    with_depth: bool = True,
    is_truth_blurred: bool = False,
    seconds: float | None = None,
) -> SequenceEvaluation:
    """Compare a reconstruction with the truth.

    Parameters
    ----------
    sequence : DatasetSequence
    loaded : LoadedSequence
        The reconstructed frames.
    result : SequenceResult
        Poses and depth of each frame.
    camera : Camera
        Camera of the original frames: the true depth is resampled to its pinhole image.
    step : int
        Step with which `loaded` was loaded.
    poses_given : bool
        Whether poses were given: they are then not compared, and depth is not scaled.
    max_depth : float, optional
        Larger true depth counts as unknown, m.
    with_depth : bool
        Whether to compare depth.
    is_truth_blurred : bool
        Whether the sensor of the true depth blurs outlines: they are then found in larger windows,
        see `tisfm.metrics.outlines_of_blurred_depth`.
    seconds : float, optional
        Time of the reconstruction.

    Returns
    -------
    SequenceEvaluation

    Raises
    ------
    ValueError
        If the number of frames, or the size of depth, differs from the result.
    OSError
        If a depth map cannot be read.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.datasets import find_sequences
    >>> from tisfm.evaluation import compare_sequence
    >>> (sequence,) = find_sequences("calibrated")
    >>> result = tisfm.Reconstruction.load("walk")
    >>> errors = compare_sequence(sequence, sequence.load(), result, camera=result.camera)
    >>> errors.posed, errors.depth.error < 0.2
    (9, True)
    """
    count = len(loaded.frames)
    if np.shape(result.poses) != (count, 4, 4):
        raise InputError(
            f"the result has poses of shape {np.shape(result.poses)}: expected ({count}, 4, 4), "
            "one for each frame; give the result of the same frames, with the same step"
        )
    path = path_length(loaded.poses) if loaded.posed.any() else None
    compares_depth = with_depth and any(file is not None for file in loaded.depths)
    return SequenceEvaluation(
        sequence=sequence,
        step=step,
        frames=count,
        posed=int(np.isfinite(result.poses[:, 0, 0]).sum()),
        path=path,
        pieces=() if poses_given else _compare_pieces(result, loaded, path),
        depth=sequence_depth_errors(
            loaded,
            result,
            camera=camera,
            scale=1.0 if poses_given else None,
            max_depth=max_depth,
            is_truth_blurred=is_truth_blurred,
        )
        if compares_depth
        else None,
        poses_given=poses_given,
        seconds=seconds,
        statuses=dict(Counter(map(str, result.status))),
    )


def reconstruct_and_compare(
    # sequence, loaded, camera, step, max_depth: as for `compare_sequence`
    sequence: DatasetSequence,
    loaded: LoadedSequence,
    *,
    camera: Camera,
    settings: Settings,
    step: int = 1,
    give_poses: bool = False,  # whether to give the true poses and compare depth alone
    max_depth: float | None = None,
    progress: Progress | None = None,  # as for `tisfm.reconstruct`
) -> tuple[SequenceEvaluation, SequenceResult]:
    """Reconstruct a sequence by `tisfm.reconstruct`, and compare it with the truth.

    Raises ValueError: as `compare_sequence`; and if poses are to be given but some are unknown.
    """
    if give_poses and not loaded.posed.all():
        raise InputError(
            f"poses are to be given, but {np.count_nonzero(~loaded.posed)} of "
            f"{len(loaded.frames)} frames have no true pose"
        )
    begin = time.perf_counter()
    result = tisfm.reconstruct(
        loaded.frames,
        camera=camera,
        settings=settings,
        poses=loaded.poses if give_poses else None,
        progress=progress,
    )
    seconds = time.perf_counter() - begin
    evaluation = compare_sequence(
        sequence,
        loaded,
        result,
        camera=camera,
        step=step,
        poses_given=give_poses,
        max_depth=max_depth,
        seconds=seconds,
    )
    return evaluation, result


def as_record(evaluation: SequenceEvaluation) -> dict[str, Any]:
    """Return the evaluation of a sequence as plain values for JSON."""
    record = asdict(evaluation)
    sequence = record.pop("sequence")
    return {
        "name": sequence["name"],
        "layout": sequence["layout"],
        "folder": str(sequence["folder"]),
        **record,
        "largest_share": evaluation.largest_share,
    }


def _compare_pieces(
    result: SequenceResult, loaded: LoadedSequence, path: float | None
) -> tuple[PieceErrors, ...]:
    pieces = np.asarray(result.piece)
    numbers, counts = np.unique(pieces[pieces >= 0], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    piece_errors = []
    for number in numbers[order]:
        is_in_piece = (pieces == number)[:, None, None]
        poses = np.where(is_in_piece, result.poses, np.nan)
        if result.status[int(np.argmax(pieces == number))] == "pure_rotation":
            count = int(np.count_nonzero(pieces == number))
            piece_errors.append(PieceErrors(piece=int(number), frames=count))
            continue
        piece_errors.append(_compare_piece(int(number), poses, loaded.poses, path))
    return tuple(piece_errors)


def _compare_piece(
    number: int, poses: NDArray[np.float64], truth: NDArray[np.float64], path: float | None
) -> PieceErrors:
    has_pose = np.isfinite(poses[:, 0, 0])
    has_both = has_pose & np.isfinite(truth[:, 0, 0])
    if has_both.sum() < MIN_POSES:
        return PieceErrors(piece=number, frames=int(has_pose.sum()))
    absolute = absolute_errors(poses, truth)
    return PieceErrors(
        piece=number,
        frames=int(has_pose.sum()),
        absolute=absolute,
        share=absolute.similarity / path if path else None,
        rigid_share=absolute.rigid / path if path else None,
        relative=relative_errors(poses, truth, scale=absolute.scale),
        relative_step=relative_errors(poses, truth, step=LONG_STEP, scale=absolute.scale),
        drift=drift(poses, truth, scale=absolute.scale),
    )
