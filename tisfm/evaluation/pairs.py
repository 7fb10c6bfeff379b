"""Interpretations of pairs, compared with known flow, depth or pose."""

import os
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from tisfm.camera import Camera, check_pinhole
from tisfm.datasets import DatasetPair, LoadedPair
from tisfm.errors import InputError, InputTypeError, is_user_error
from tisfm.evaluation.pair_errors import (
    LITTLE_PARALLAX_STATUSES,
    MeanErrors,
    PairEvaluation,
    mean_errors,
)
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

_WARM_UP_SIDE = 64  # px: side of the frames for which kernels are compiled; set by hand


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """An evaluation of some pairs with one set of settings.

    Attributes
    ----------
    settings : Settings
    pairs : tuple of PairEvaluation
        In the given order.

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
        """The failed pairs."""
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
        """Means of each dataset; None for a dataset whose pairs have all failed."""
        return {name: mean_errors(pairs) for name, pairs in self.datasets.items()}

    @property
    def mean(self) -> MeanErrors | None:
        """Means over all pairs; None if all have failed."""
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

    With ``motion="camera"``, a pose that the dataset knows beforehand, as for a rectified stereo
    pair, is given to the interpretation. For a camera with distortion or oblong pixels, the true
    depth is resampled like the frames. A pair that cannot be read, interpreted or compared is
    recorded as failed, and the evaluation goes on. Kernels are compiled beforehand, so that times
    do not include the compilation.

    Parameters
    ----------
    pairs : iterable of DatasetPair
        For example from `tisfm.datasets.find_pairs`. Duplicates are evaluated once.
    camera : Camera, optional
        Camera of every pair; by default the camera of the dataset, or else `Camera()`.
    settings : Settings, optional
        By default the preset "balanced".
    give_poses : bool
        Whether to give all true poses and compare depth alone, for ``motion="camera"``.
    max_depth : float, optional
        Larger true depth counts as unknown; in the unit of the dataset.
    on_load : callable, optional
        Called with a loaded pair before it is interpreted. Its errors make the pair fail.
    on_pair : callable, optional
        Called after every pair with evaluation, interpretation and loaded pair (None for a failed
        pair). Its errors make the pair fail; it is then called again with the failed pair.

    Returns
    -------
    Evaluation

    Raises
    ------
    TypeError
        If `camera` or `settings` is not of its type.
    ValueError
        If `camera` has distortion or oblong pixels, as the true flow belongs to the original
        frames; if poses are given to another motion, or `max_depth` is not positive.
    Exception
        An unexpected error, which is a bug of tisfm.

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
        check_pinhole(camera, "the true flow belongs to the frames without resampling")
    settings = check_settings(settings)
    if give_poses and settings.motion != "camera":
        raise InputError(
            f'poses are to be given, but motion="{settings.motion}" leaves the motion free: choose '
            'motion="camera"'
        )
    if max_depth is not None and not max_depth > 0:
        raise InputError(f"max_depth is {max_depth}: expected a positive depth, or None")
    compiled_kinds: set[Any] = set()
    evaluations = []
    for pair in dict.fromkeys(pairs):
        try:
            loaded = pair.load()
            pair_camera = camera or loaded.camera or Camera()
            loaded = _prepare(loaded, pair_camera, give_poses=give_poses, max_depth=max_depth)
            if on_load is not None:
                on_load(loaded)
            kind = (loaded.frame0.shape[2:], loaded.frame0.dtype)
            if kind not in compiled_kinds:
                _warm_up(settings, *kind)
                compiled_kinds.add(kind)
            evaluation, result = _evaluate_pair(pair, loaded, camera=pair_camera, settings=settings)
            if on_pair is not None:
                on_pair(evaluation, result, loaded)
        except (OSError, TypeError, ValueError, RuntimeError, MemoryError) as error:
            if not is_user_error(error):
                raise
            text = " ".join(str(error).split()) or type(error).__name__
            evaluation = PairEvaluation(pair=pair, fault=text)
            if on_pair is not None:
                on_pair(evaluation, None, None)
        evaluations.append(evaluation)
    return Evaluation(settings=settings, pairs=tuple(evaluations))


def as_record(evaluation: PairEvaluation) -> dict[str, Any]:
    """Return the evaluation of a pair as plain values for JSON."""
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
    pose = loaded.pose if loaded.pose_given and settings.motion == "camera" else None
    begin = time.perf_counter()
    result = interpret(loaded.frame0, loaded.frame1, camera=camera, settings=settings, pose=pose)
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
        occlusion=_compare_occlusion(result.occlusion, loaded),
        depth=depth,
        without_depth=loaded.depth is not None and depth is None,
        pose=_pose_errors(result, loaded),
    )
    return evaluation, result


def _prepare(
    loaded: LoadedPair, camera: Camera, *, give_poses: bool, max_depth: float | None
) -> LoadedPair:
    """Return a pair with undistorted true depth, and with `pose_given` set.

    Raises ValueError if no true depth is left.
    """
    is_given = loaded.pose_given or (give_poses and loaded.pose is not None)
    loaded = replace(loaded, pose_given=is_given)
    if loaded.depth is None:
        return loaded
    depth = undistort_depth(loaded.depth, camera)
    if max_depth is not None:
        depth = np.where(depth <= max_depth, depth, np.float32(np.nan))
    if not np.isfinite(depth).any():
        limit = "" if max_depth is None else f" up to {max_depth:g}"
        known_count = np.count_nonzero(np.isfinite(loaded.depth))
        raise InputError(f"no true depth is left{limit} of {known_count} pixels that have one")
    return replace(loaded, depth=depth)


def _depth_errors(result: Interpretation, loaded: LoadedPair) -> DepthErrors | None:
    """Compare the depth with the true depth; return None if one of them is missing."""
    if loaded.depth is None or result.status in LITTLE_PARALLAX_STATUSES:
        return None
    depth = result.depth
    is_comparable = np.isfinite(loaded.depth) & np.isfinite(depth) & (depth > 0)
    return depth_errors(depth, loaded.depth) if is_comparable.any() else None


def _pose_errors(result: Interpretation, loaded: LoadedPair) -> PoseErrors | None:
    """Compare the motion of the camera with the true motion; return None if one is missing."""
    if result.motions is None or loaded.pose is None or loaded.pose_given:
        return None
    errors = pose_errors(pose_matrix(result.motions[0]), loaded.pose)
    return replace(errors, direction=None) if result.status in LITTLE_PARALLAX_STATUSES else errors


def _errors_outside(
    flow: np.ndarray, truth: np.ndarray | None, mask: np.ndarray | None
) -> FlowErrors | None:
    """Return the errors without the pixels of a mask; None without a mask or without pixels."""
    if truth is None or mask is None:
        return None
    is_compared = ~mask
    has_truth = np.isfinite(truth).all(axis=-1)
    return flow_errors(flow, truth, mask=is_compared) if (is_compared & has_truth).any() else None


def _compare_occlusion(occlusion: np.ndarray, loaded: LoadedPair) -> OcclusionScores | None:
    """Compare an occlusion map with the map of the dataset; return None if it has no map."""
    if loaded.flow is None or loaded.occlusion is None:
        return None
    has_truth = np.isfinite(loaded.flow).all(axis=-1)
    # Datasets differ in whether pixels that leave the image are occluded; here they are.
    truth = loaded.occlusion | leaves_image(np.moveaxis(loaded.flow, -1, 0))
    return occlusion_scores(occlusion, truth, mask=has_truth)


def _warm_up(settings: Settings, channels: tuple[int, ...], dtype: np.dtype) -> None:
    """Interpret a small pair of noise, so that every kernel is compiled before it is timed."""
    noise = np.random.default_rng(0).integers(0, 256, (_WARM_UP_SIDE, _WARM_UP_SIDE, *channels))
    frame0 = noise.astype(dtype)
    frame1 = np.roll(frame0, 1, axis=1)
    near_rows = slice(_WARM_UP_SIDE // 2, None)  # parallax, so that kernels for depth run too
    frame1[near_rows] = np.roll(frame0, 3, axis=1)[near_rows]
    interpret(frame0, frame1, camera=Camera(focal=_WARM_UP_SIDE), settings=settings)
