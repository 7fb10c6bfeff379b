"""The focal length of a sequence whose camera is not known, found together with its path.

It is sought from several beginnings, since an adjustment ends in the valley that it begins in: the
one that explains most of what views have in common counts. How far to trust it is told by parts of
that, each adjusted from elsewhere: where the motion does not show the focal length, they disagree.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tisfm.camera import LONGEST, SHORTEST, Camera
from tisfm.focal_guess import FocalGuess
from tisfm.reconstruction.calibration import GIVEN, Calibration
from tisfm.reconstruction.colmap import pycolmap
from tisfm.reconstruction.growing import robust
from tisfm.reconstruction.mapping import Model, Shared, View, models_of

STARTS = (1.0, 0.42, 2.4)  # times the guess: focal lengths to begin with
WINDOW = 16  # views: of each of the two windows that beginnings are compared on
ENOUGH = 6000  # observations that parts are made of
STEPS, TOLERANCE = 150, 1e-6  # of the adjustments that end in it
AWAY = 1.2  # times: the focal length that a part begins with, or as much less
# Of the logarithm: what parts are off by, as a share of it the deviation of the whole.
OF_PARTS = 0.7
UNSEEN = 0.05  # of the focal length: with a larger deviation, the motion does not show it
WORTHLESS = 0.2  # with a larger one, a guess is as good
UNSEEN_SAID = (
    "the motion does not show the focal length, as where the camera goes straight on without "
    "turning or all lies in one plane"
)
HARDLY_SAID = "the motion hardly shows it"
ADVICE = "give it if you know it, for instance from a calibration"


@dataclass(frozen=True, kw_only=True)
class FocalEstimate:
    """A focal length that was found from a sequence.

    Attributes
    ----------
    focal : float
        px.
    deviation : float
        Standard deviation, px; infinite where the sequence says nothing.
    """

    focal: float
    deviation: float

    def taken(self, camera: Camera) -> Camera:
        """Return a camera with it, or as it is if a guess is as good."""
        return replace(camera, focal=self.focal) if self.is_of_use else camera

    @property
    def is_of_use(self) -> bool:
        """Whether it says more than a guess."""
        return self.deviation <= WORTHLESS * self.focal


def calibration_of(
    found: FocalEstimate | None, guess: FocalGuess | None, camera: Camera, *, sought: bool
) -> Calibration:
    """Return where the focal length of a camera is from.

    Parameters
    ----------
    found : FocalEstimate or None
        From the sequence.
    guess : FocalGuess or None
        From the first file or the size of frames; None if a camera was given.
    camera : Camera
        As it is used.
    sought : bool
        Whether it was to be found from the sequence.
    """
    if not sought and guess is None:
        return GIVEN
    if found is None or not found.is_of_use:
        told = f"the focal length is a guess, {camera.focal:.0f} px"
        if guess is not None:
            told += f", {guess.reason}"
        if sought:
            told += f": {'no path was found' if found is None else UNSEEN_SAID}"
        message = f"{told}; {ADVICE}"
        return Calibration(origin="guessed", focal_std=math.inf, seen=False, message=message)
    deviation = float(f"{found.deviation:.1g}")  # one digit of it says enough
    told = f"{found.focal:.4g} ± {deviation:g} px, found from the sequence"
    seen = found.deviation <= UNSEEN * found.focal
    message = told if seen else f"the focal length is {told}: {HARDLY_SAID}; {ADVICE}"
    return Calibration(origin="estimated", focal_std=found.deviation, seen=seen, message=message)


def models_and_focal(
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
) -> tuple[list[Model], FocalEstimate | None]:
    """Find poses of views and points of tracks, and the focal length with which they fit best.

    Parameters
    ----------
    views, matches, shape
        As for `tisfm.reconstruction.mapping.models_of`.
    camera : Camera
        A pinhole, whose centre is known and whose focal length is a guess.

    Returns
    -------
    models : list of Model
        With that focal length, or with the guess if it is as good.
    found : FocalEstimate or None
        None if no path is found with any.
    """
    shared = Shared.of(views, matches, shape)
    begun = _best_start(shared, camera)
    found = [] if begun is None else shared.grown(replace(camera, focal=begun), refine_focal=True)
    if not found:
        models = models_of(views, matches, camera, shape)
        return models, _unknown(camera) if models else None
    _adjust(found[0])
    estimate = _estimate(found[0], camera, shape)
    if not estimate.is_of_use:
        return models_of(views, matches, camera, shape), estimate
    for other in found[1:]:
        _set_focal(other, estimate.focal)
        _adjust(other, refine_focal=False)
    return shared.models(found, views, estimate.taken(camera)), estimate


def _estimate(whole: Any, camera: Camera, shape: tuple[int, int]) -> FocalEstimate:
    """Return the focal length of a reconstruction, and what its parts say of it."""
    focal = _focal(whole)
    if not _is_possible(focal):
        return _unknown(camera)
    parts = [
        _of_part(whole, part, focal * AWAY ** (1 if k % 2 else -1))
        for k, part in enumerate(_parts(whole, camera, shape))
    ]
    if not all(map(_is_possible, parts)):
        return _unknown(camera)
    off = np.log(np.divide(parts, focal))
    deviation = OF_PARTS * math.sqrt(np.mean(np.square(off)))
    return FocalEstimate(focal=focal, deviation=focal * deviation)


def _unknown(guess: Camera) -> FocalEstimate:
    return FocalEstimate(focal=guess.focal, deviation=math.inf)


def _is_possible(focal: float) -> bool:
    """Return whether a camera may have it: an adjustment is free to end anywhere."""
    return SHORTEST <= focal <= LONGEST


def _best_start(shared: Shared, camera: Camera) -> float | None:
    """Return the focal length, px, that explains most of what views in windows have in common."""
    best, most = None, 0
    for times in STARTS:
        explained, found = 0, []
        for window in _windows(shared):
            grown = window.grown(replace(camera, focal=times * camera.focal), refine_focal=True)
            if grown and _is_possible(_focal(grown[0])):
                explained += grown[0].compute_num_observations()
                found.append(_focal(grown[0]))
        if explained > most:
            best, most = float(np.exp(np.mean(np.log(found)))), explained
    return best


def _windows(shared: Shared) -> list[Shared]:
    count = len(shared.views)
    if count <= 2 * WINDOW:
        return [shared]
    begins = (count // 4 - WINDOW // 2, count - count // 4 - WINDOW // 2)
    return [shared.part(begin, begin + WINDOW) for begin in begins]


def _parts(whole: Any, camera: Camera, shape: tuple[int, int]) -> list[tuple[set[int], set[int]]]:
    """Return views and points of parts: halves of the time, and of the image.

    Of the points, those that most views see, as many as are enough.
    """
    views = sorted(whole.reg_image_ids())
    lengths = {number: point.track.length() for number, point in whole.points3D.items()}
    points, count = set(), 0
    for number in sorted(lengths, key=lambda one: (-lengths[one], one)):
        if count < ENOUGH:
            points.add(number)
            count += lengths[number]
    half = max(2, len(views) // 2)
    parts = [(set(views[:half]), points), (set(views[-half:]), points)]
    center = camera.center_for(*shape)
    places = {number: _places(whole, whole.points3D[number]).mean(axis=0) for number in points}
    for axis in (0, 1):
        near = {number for number in points if places[number][axis] < center[axis]}
        parts += [(set(views), near), (set(views), points - near)]
    return parts


def _places(whole: Any, point: Any) -> np.ndarray:
    """Return where a point is seen, (N, 2), px."""
    images = whole.images
    return np.array(
        [images[one.image_id].points2D[one.point2D_idx].xy for one in point.track.elements]
    )


def _of_part(whole: Any, part: tuple[set[int], set[int]], begun: float) -> float:
    """Return the focal length, px, that some views and points lead to from another one."""
    views, points = part
    less = copy.deepcopy(whole)
    for number in sorted(set(less.reg_image_ids()) - views):
        less.deregister_frame(less.images[number].frame_id)
    few = [k for k, point in less.points3D.items() if k not in points or point.track.length() < 2]
    for number in few:
        less.delete_point3D(number)
    _set_focal(less, begun)
    _adjust(less)
    return _focal(less)


def _adjust(whole: Any, *, refine_focal: bool = True) -> None:
    """Adjust poses and points, and the focal length with them, to the end."""
    options = pycolmap().BundleAdjustmentOptions()
    options.refine_focal_length = refine_focal
    options.refine_extra_params = options.refine_principal_point = False
    scene = pycolmap().BundleAdjustmentConfig()
    for number in sorted(whole.reg_image_ids()):
        scene.add_image(number)
    scene.fix_gauge(pycolmap().BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    robust(options, STEPS, TOLERANCE)
    pycolmap().create_default_bundle_adjuster(options, scene, whole).solve()


def _focal(whole: Any) -> float:
    return float(next(iter(whole.cameras.values())).params[0])


def _set_focal(whole: Any, focal: float) -> None:
    camera = next(iter(whole.cameras.values()))
    camera.params = [focal, *camera.params[1:]]
