"""Interpretations of pairs whose flow, depth or pose is known, compared with it."""

import os
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from tisfm.camera import Camera, check_pinhole
from tisfm.datasets import DatasetPair, LoadedPair
from tisfm.errors import InputError, InputTypeError, is_user_error
from tisfm.evaluation.means import MeanErrors, mean_errors
from tisfm.evaluation.record import LITTLE_PARALLAX, PairEvaluation
from tisfm.interpretation import Interpretation
from tisfm.lens import undistort_depth
from tisfm.metrics import (
    DepthErrors,
    FlowErrors,
    OcclusionScores,
    PoseErrors,
    depth_errors,
    flow_errors,
    occlusion_scores,
    pose_errors,
)
from tisfm.pair import interpret
from tisfm.rigid import pose_matrix
from tisfm.settings import Settings, check_settings
from tisfm.visibility.occlusion import leaves_image

_WARM_UP_SIDE = 64  # px


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """An evaluation of some pairs with one set of settings.

    Attributes
    ----------
    settings : Settings
    pairs : tuple of PairEvaluation
        In the order they were given.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.evaluation import Evaluation
    >>> evaluation = Evaluation(settings=tisfm.Settings(), pairs=())  # `evaluate` makes it
    >>> evaluation.mean is None
    True
    """

    settings: Settings
    pairs: tuple[PairEvaluation, ...]

    @property
    def faults(self) -> list[PairEvaluation]:
        """The pairs that could not be evaluated."""
        return [pair for pair in self.pairs if pair.fault is not None]

    @property
    def datasets(self) -> dict[str, list[PairEvaluation]]:
        """The pairs of each dataset, in order."""
        groups: dict[str, list[PairEvaluation]] = {}
        for pair in self.pairs:
            groups.setdefault(pair.pair.dataset, []).append(pair)
        return groups

    @property
    def dataset_means(self) -> dict[str, MeanErrors | None]:
        """Means of each dataset; None for one of which no pair could be evaluated."""
        return {name: mean_errors(pairs) for name, pairs in self.datasets.items()}

    @property
    def mean(self) -> MeanErrors | None:
        """Means over all pairs; None if none could be evaluated."""
        return mean_errors(self.pairs)


def evaluate(
    pairs: Iterable[DatasetPair],
    *,
    camera: Camera | None = None,
    settings: Settings | None = None,
    give_poses: bool = False,
    max_depth: float | None = None,
    on_load: Callable[[LoadedPair], None] | None = None,
    on_pair: Callable[[PairEvaluation, Interpretation | None, LoadedPair | None], None]
    | None = None,
) -> Evaluation:
    """Interpret pairs and compare their flow, depth and pose with the truth.

    A pose that the dataset knows beforehand, as of a rectified stereo pair, is given to
    interpretations that recover one motion of the camera (``motion="camera"``). Where a camera has
    distortion or oblong pixels, the true depth is resampled as the frames are. A pair that cannot
    be read, interpreted or compared is recorded with its fault, and the others go on. Kernels are
    compiled beforehand, so that no time includes it.

    Parameters
    ----------
    pairs : iterable of DatasetPair
        Such as from `tisfm.datasets.find_pairs`. One that is given twice is evaluated once.
    camera : Camera, optional
        Camera of every pair; by default the one that the dataset states, or else `Camera()`.
    settings : Settings, optional
        By default those of the preset "balanced".
    give_poses : bool
        Whether every true pose is given, and only depth is compared, for ``motion="camera"``.
    max_depth : float, optional
        True depth beyond it is taken to be unknown; in the unit of the dataset.
    on_load : callable, optional
        Called with what was loaded of a pair before it is interpreted. An error that it raises is
        the fault of the pair.
    on_pair : callable, optional
        Called after every pair with its evaluation, the interpretation and what was loaded (None
        for a pair with a fault). An error that it raises is the fault of the pair, and it is then
        called once more with that.

    Returns
    -------
    Evaluation

    Raises
    ------
    TypeError
        If `camera` or `settings` is not of its type.
    ValueError
        If `camera` has distortion or oblong pixels: the true flow is that of the frames as they
        are. If poses are to be given to another motion, or `max_depth` is not positive.
    Exception
        What nobody foresaw, which is a bug and no fault of a pair.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.datasets import find_pairs
    >>> from tisfm.evaluation import evaluate
    >>> pairs = find_pairs("calibrated", step=4)[:1]
    >>> settings = tisfm.Settings.preset("fast", motion="camera")
    >>> evaluation = evaluate(pairs, settings=settings)
    >>> evaluation.faults
    []
    >>> evaluation.pairs[0].depth.abs_rel < 0.5
    True
    """
    if camera is not None:
        if not isinstance(camera, Camera):
            raise InputTypeError(f"camera is {camera!r}: expected a tisfm.Camera, or None")
        check_pinhole(camera, "the true flow is that of the frames as they are")
    settings = check_settings(settings)
    if give_poses and settings.motion != "camera":
        raise InputError(
            f'poses are to be given, but motion="{settings.motion}" leaves the motion free: choose '
            'motion="camera"'
        )
    if max_depth is not None and not max_depth > 0:
        raise InputError(f"max_depth is {max_depth}: expected a positive depth, or None")
    compiled: set[Any] = set()
    done = []
    for pair in dict.fromkeys(pairs):
        try:
            loaded = pair.load()
            taken_by = camera or loaded.camera or Camera()
            loaded = _prepared(loaded, taken_by, give_poses=give_poses, max_depth=max_depth)
            if on_load is not None:
                on_load(loaded)
            kind = (loaded.frame0.shape[2:], loaded.frame0.dtype)
            if kind not in compiled:
                _warm_up(settings, *kind)
                compiled.add(kind)
            evaluation, result = _evaluate_pair(pair, loaded, camera=taken_by, settings=settings)
            if on_pair is not None:
                on_pair(evaluation, result, loaded)
        except (OSError, TypeError, ValueError, RuntimeError, MemoryError) as error:
            if not is_user_error(error):
                raise
            text = " ".join(str(error).split()) or type(error).__name__
            evaluation = PairEvaluation(pair=pair, fault=text)
            if on_pair is not None:
                on_pair(evaluation, None, None)
        done.append(evaluation)
    return Evaluation(settings=settings, pairs=tuple(done))


def as_record(evaluation: PairEvaluation) -> dict[str, Any]:
    """Return everything about a pair as plain values, for JSON."""
    record = asdict(evaluation)
    pair = {
        key: os.fspath(value) if isinstance(value, os.PathLike) else value
        for key, value in record.pop("pair").items()
    }
    names = {key: pair.pop(key) for key in ("dataset", "name", "layout")}
    return {**names, **record, "inputs": pair}


def _evaluate_pair(
    pair: DatasetPair, loaded: LoadedPair, *, camera: Camera, settings: Settings
) -> tuple[PairEvaluation, Interpretation]:
    """Interpret one pair and compare it with the truth."""
    given = loaded.pose if loaded.pose_given and settings.motion == "camera" else None
    begin = time.perf_counter()
    result = interpret(loaded.frame0, loaded.frame1, camera=camera, settings=settings, pose=given)
    seconds = time.perf_counter() - begin
    height, width = loaded.frame0.shape[:2]
    depth = _depth_errors(result, loaded)
    evaluation = PairEvaluation(
        pair=pair,
        size=(height, width),
        camera=camera,
        status=str(result.status),
        message=result.status.message,
        seconds=seconds,
        errors=None if loaded.flow is None else flow_errors(result.flow, loaded.flow),
        visible=_errors_outside(result.flow, loaded.flow, loaded.occlusion),
        without_sky=_errors_outside(result.flow, loaded.flow, loaded.sky),
        occlusion=_scores(result.occlusion, loaded),
        depth=depth,
        without_depth=loaded.depth is not None and depth is None,
        pose=_pose_errors(result, loaded),
    )
    return evaluation, result


def _prepared(
    loaded: LoadedPair, camera: Camera, *, give_poses: bool, max_depth: float | None
) -> LoadedPair:
    """Return a pair with the depth that its pinhole frames show, and its pose given if it is to be.

    Raises
    ------
    ValueError
        If no true depth is left.
    """
    given = loaded.pose_given or (give_poses and loaded.pose is not None)
    loaded = replace(loaded, pose_given=given)
    if loaded.depth is None:
        return loaded
    depth = undistort_depth(loaded.depth, camera)
    if max_depth is not None:
        depth = np.where(depth <= max_depth, depth, np.float32(np.nan))
    if not np.isfinite(depth).any():
        limit = "" if max_depth is None else f" up to {max_depth:g}"
        known = np.count_nonzero(np.isfinite(loaded.depth))
        raise InputError(f"no true depth is left{limit} of {known} pixels that have one")
    return replace(loaded, depth=depth)


def _depth_errors(result: Interpretation, loaded: LoadedPair) -> DepthErrors | None:
    """Compare the depth with the true one, or return None if one of them does not exist."""
    if loaded.depth is None or result.status in LITTLE_PARALLAX:
        return None
    depth = result.depth
    comparable = np.isfinite(loaded.depth) & np.isfinite(depth) & (depth > 0)
    return depth_errors(depth, loaded.depth) if comparable.any() else None


def _pose_errors(result: Interpretation, loaded: LoadedPair) -> PoseErrors | None:
    """Compare the motion of the camera with the true one, or return None if there is none."""
    if result.motions is None or loaded.pose is None or loaded.pose_given:
        return None
    errors = pose_errors(pose_matrix(result.motions[0]), loaded.pose)
    return replace(errors, direction=None) if result.status in LITTLE_PARALLAX else errors


def _errors_outside(
    flow: np.ndarray, truth: np.ndarray | None, mask: np.ndarray | None
) -> FlowErrors | None:
    """Return the errors without the pixels of a mask, or None if there is none or no pixel is."""
    if truth is None or mask is None:
        return None
    counted = ~mask
    known = np.isfinite(truth).all(axis=-1)
    return flow_errors(flow, truth, mask=counted) if (counted & known).any() else None


def _scores(occlusion: np.ndarray, loaded: LoadedPair) -> OcclusionScores | None:
    """Compare a map of occlusion with the dataset's, or return None if it has none."""
    if loaded.flow is None or loaded.occlusion is None:
        return None
    known = np.isfinite(loaded.flow).all(axis=-1)
    # Datasets differ in whether what leaves the image is occluded; to us it is.
    truth = loaded.occlusion | leaves_image(np.moveaxis(loaded.flow, -1, 0))
    return occlusion_scores(occlusion, truth, mask=known)


def _warm_up(settings: Settings, channels: tuple[int, ...], dtype: np.dtype) -> None:
    """Interpret a small pair of noise, so that every kernel is compiled before it is timed."""
    noise = np.random.default_rng(0).integers(0, 256, (_WARM_UP_SIDE, _WARM_UP_SIDE, *channels))
    frame = noise.astype(dtype)
    moved = np.roll(frame, 1, axis=1)
    nearer = slice(_WARM_UP_SIDE // 2, None)  # parallax, without which depth is not looked for
    moved[nearer] = np.roll(frame, 3, axis=1)[nearer]
    interpret(frame, moved, camera=Camera(focal=_WARM_UP_SIDE), settings=settings)
