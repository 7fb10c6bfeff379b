"""The result of a pair: 3D motion, depth, image motion, and their confidence."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tisfm.camera import Camera
from tisfm.grade import Grade, depth_error, grade_depth, warn_of_grades
from tisfm.point_cloud import MAX_MEDIAN_DEPTHS, PointCloud, point_cloud
from tisfm.settings import Settings
from tisfm.status import History, Status


@dataclass(frozen=True, kw_only=True, eq=False)
class Interpretation:
    """The 3D interpretation of a pair of frames.

    Equations are numbered as in the paper of Sekkati and Mitiche (`tisfm.interpret`).

    Attributes
    ----------
    rho : (6, H, W) float32
        ρ̂ = f·(τ, ω), px/frame: translation over depth, and rotation, times the focal length. ω is
        zero under the translation model.
    flow : (H, W, 2) float32
        Image motion (u, v) of eq. 25, px/frame, u to the right and v down.
    inverse_depth : (H, W) float32
        Relative inverse depth, in the inverse unit of T. For ``motion="field"`` it is ‖τ‖
        (eq. 24), with ‖T‖ = 1: correct if the scene translates parallel to the image plane; for
        other motions see docs/trust.md. For ``motion="camera"`` it is signed; T has length 1, or
        the length of the translation in a given pose. For ``"objects"`` each label has the unit of
        its own T. 0 where the frames do not show depth: everywhere if the status says so, or on a
        background without parallax.
    inverse_depth_std : (H, W) float32 or None
        Standard deviation of the inverse depth: of the pixels visible in frame 1, about 68% have
        a smaller error. Infinite where there is no depth, never 0. None for ``motion="field"``.
    confidence : (H, W) float32
        In [0, 1]: how much the data in a window of 15 px around a pixel determine its image
        motion, as opposed to the motion of its neighbours. 0 where the pixel is not visible in
        frame 1.
    occlusion : (H, W) bool
        True where a pixel is not visible in frame 1: it leaves the image, or is hidden there.
    motions : (K, 6) float64 or None
        Twists (T, ω) of the rigid motions, per frame, with ‖T‖ = 1, or, with `align_scales`, in
        the unit of the background's T. `tisfm.rigid.rigid_motion` gives R and t of P₁ = R P₀ + t.
        T is 0 if the camera only turned or did not move. None for ``motion="field"``.
    labels : (H, W) int32 or None
        Index into `motions` of each pixel. None for ``motion="field"``.
    frame : (H, W) or (H, W, 3) uint8
        Frame 0 on the 8-bit scale, without distortion and, if it was undone, without the effect
        of the rolling shutter. Pictures of the result are drawn on it.
    camera : Camera
        The pinhole camera of `frame` and of all maps, without distortion. Its readout is 0 if the
        effect of the rolling shutter was undone.
    settings : Settings
    status : Status
        A code that compares as text; ``status.message`` says what to try.
    history : History
        Energy and relative change of every iteration.
    version : str
        Version of tisfm that computed it.
    focal_deviation : float
        Relative standard deviation of the focal length: 0 if it was given, infinite for a guess.
        `depth_error` and `grade` depend on it, and for a guess on the next two.
    focal_effect : float
        Relative change of depth over a relative change of the focal length, up to scale; NaN where
        unknown.
    focal_spread : float
        Relative standard deviation of the focal length that the image motion of this pair alone
        shows, with the distance from the focal length that fits it best; NaN where unknown.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.scenes import static_scene
    >>> scene = static_scene("sideways", 96, 128)
    >>> settings = tisfm.Settings.preset("fast", motion="camera")
    >>> result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)
    >>> result.flow.shape, result.tau.shape, result.depth.shape
    ((96, 128, 2), (3, 96, 128), (96, 128))
    >>> result.motions.shape  # one twist (T, ω), ‖T‖ = 1
    (1, 6)
    >>> bool((result.confidence[result.occlusion] == 0).all())
    True
    """

    rho: np.ndarray = field(repr=False)
    flow: np.ndarray = field(repr=False)
    inverse_depth: np.ndarray = field(repr=False)
    confidence: np.ndarray = field(repr=False)
    occlusion: np.ndarray = field(repr=False)
    frame: np.ndarray = field(repr=False)
    camera: Camera
    settings: Settings
    status: Status
    history: History = field(repr=False)
    version: str
    inverse_depth_std: np.ndarray | None = field(default=None, repr=False)
    motions: np.ndarray | None = None
    labels: np.ndarray | None = field(default=None, repr=False)
    focal_deviation: float = field(default=0.0, repr=False)
    focal_effect: float = field(default=math.nan, repr=False)
    focal_spread: float = field(default=math.nan, repr=False)

    @cached_property
    def tau(self) -> np.ndarray:
        """Scaled translation τ = T/Z, (3, H, W) float32, 1/frame."""
        return self.rho[:3] / np.float32(self.camera.focal)

    @cached_property
    def omega(self) -> np.ndarray:
        """Rotation ω, (3, H, W) float32, rad/frame."""
        return self.rho[3:] / np.float32(self.camera.focal)

    @cached_property
    def depth(self) -> np.ndarray:
        """Relative depth, (H, W) float32; NaN where the inverse depth is 0 or negative."""
        depth = np.full_like(self.inverse_depth, np.nan)
        np.divide(1, self.inverse_depth, out=depth, where=self.inverse_depth > 0)
        return depth

    @cached_property
    def depth_error(self) -> float:
        """Expected relative error of the depth; NaN without depth, or with ``motion="field"``.

        Half of the pixels that are visible in frame 1 should have a smaller error, apart from the
        scale. It follows from the deviations of depth and of the focal length, and is at most 1.
        """
        return self._depth_quality[0]

    @cached_property
    def depth_share(self) -> float:
        """Share of the pixels whose depth is expected to be off by at most 10 %; 0 if unknown."""
        return self._depth_quality[1]

    @property
    def grade(self) -> Grade:
        """How far the depth can be trusted; ``"poor"`` for the depth of ``motion="field"``.

        Examples
        --------
        >>> import tisfm
        >>> from tisfm.scenes import static_scene
        >>> scene = static_scene("sideways", 96, 128)
        >>> settings = tisfm.Settings.preset("fast", motion="camera")
        >>> frames = scene.frame0, scene.frame1
        >>> result = tisfm.interpret(*frames, camera=scene.camera, settings=settings)
        >>> result.grade.is_green, result.depth_error < 0.1
        (True, True)
        """
        has_unrated_depth = self.inverse_depth_std is None and bool((self.inverse_depth > 0).any())
        return grade_depth(self.status, 1.0 if has_unrated_depth else self.depth_error)

    @cached_property
    def _depth_quality(self) -> tuple[float, float]:
        if self.inverse_depth_std is None:
            return float("nan"), 0.0
        return depth_error(
            self.inverse_depth,
            self.inverse_depth_std,
            float(np.fmin(self.focal_deviation, self.focal_spread)),
            None if np.isnan(self.focal_effect) else self.focal_effect,
        )

    def points(
        self,
        *,
        min_confidence: float = 0.0,
        max_depth: float | None = MAX_MEDIAN_DEPTHS,
        occluded: bool = False,
    ) -> PointCloud:
        """Return the scene as coloured points, one for every pixel with a depth.

        Parameters
        ----------
        min_confidence : float
            In [0, 1]: pixels of less confidence are left out.
        max_depth : float or None
            Largest depth, as a multiple of the median depth of the selected pixels; farther pixels
            are left out, because a depth is a guess if its inverse is nearly 0. None for no limit.
        occluded : bool
            Whether to include pixels that are not visible in frame 1. Their depth comes from their
            neighbours.

        Returns
        -------
        PointCloud
            Used as an array it is (N, 3) float32: X right, Y down, Z forward, in the axes of the
            camera at frame 0 and the relative scale of `depth`. It has ``colors``, ``confidence``,
            and ``save(path)`` for a PLY file. It may be empty.

        Raises
        ------
        TypeError, ValueError
            If `min_confidence` is not in [0, 1], or `max_depth` not positive.

        Examples
        --------
        >>> import tisfm
        >>> from tisfm.scenes import static_scene
        >>> scene = static_scene("sideways", 96, 128)
        >>> settings = tisfm.Settings.preset("fast", motion="camera")
        >>> frames = scene.frame0, scene.frame1
        >>> result = tisfm.interpret(*frames, camera=scene.camera, settings=settings)
        >>> cloud = result.points(min_confidence=0.3)
        >>> cloud.positions.shape[1], cloud.colors.dtype, 0 < len(cloud) < 96 * 128
        (3, dtype('uint8'), True)
        >>> cloud.save("pair.ply")
        """
        points = point_cloud(
            self.depth,
            self.camera,
            frame=self.frame,
            confidence=self.confidence,
            occlusion=self.occlusion,
            min_confidence=min_confidence,
            max_depth=max_depth,
            occluded=occluded,
        )
        note = warn_of_grades([self.grade], [self.status], [self.depth_error])
        return replace(points, note=note)

    def save(self, path: str | Path, *, compact: bool = False) -> None:
        """Write the result to an ``.npz`` file without pickles; after an error there is no file.

        `load` returns the same values, apart from two roundings: `rho`, and with it `tau` and
        `omega`, to 11 significant bits (and to 6e-8 px/frame where it is tiny), and `confidence` to
        11 bits.
        If `rho` has values beyond 65504, which happens if a result diverged, it is not rounded.
        `numpy.load` reads the file too; ``docs/formats.md`` describes it.

        A compact file, as `tisfm run` writes it, has a quarter of the bytes and rounds more:
        `flow` and `rho`, px/frame, and `confidence` to multiples of 2⁻¹⁰, inverse depth and its
        deviation to 12 significant bits. If all values of an array are small, the multiples are at
        most 2⁻¹² of its largest value. Arrays are packed, unless the result diverged.

        Parameters
        ----------
        path : path
            The file. Its customary suffix is ``.npz``; no suffix is added.
        compact : bool, default False
            Whether to round more and to compress.

        Raises
        ------
        OSError
            If the folder does not exist or cannot be written to.
        ValueError
            If a value is masked, or if `load` would refuse the file: if arrays do not fit each
            other, or hold NaN or infinity although the status is neither ``"diverged"`` nor
            ``"pose_mismatch"``.

        Examples
        --------
        >>> import tisfm
        >>> from tisfm.scenes import two_blocks
        >>> scene = two_blocks(48, 64)
        >>> result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera)
        >>> result.save("pair.npz")
        >>> result.save("small.npz", compact=True)  # rounded, and a quarter of the bytes
        """
        from tisfm.interpretation_file import write_interpretation

        write_interpretation(path, self, compact=compact)

    @classmethod
    def load(cls, path: str | Path) -> "Interpretation":
        """Read a file that `save` wrote.

        No code in the file is run, and every shape, type and name is checked before an array is
        read. A compact file may hold at most 2²⁴ pixels, or one pixel for each of its bytes
        if these are more.

        Raises
        ------
        FileNotFoundError, IsADirectoryError, OSError
            If the file does not exist or cannot be read.
        tisfm.formats.FormatError
            A ValueError: if the file is not a complete interpretation, or has a format that this
            version cannot read.
        MemoryError
            If there is not enough memory to load the file.

        Examples
        --------
        >>> import tisfm
        >>> from tisfm.scenes import two_blocks
        >>> scene = two_blocks(48, 64)
        >>> result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera)
        >>> result.save("pair.npz")
        >>> again = tisfm.Interpretation.load("pair.npz")
        >>> bool((again.flow == result.flow).all())
        True
        """
        from tisfm.interpretation_file import read_interpretation

        return cls(**read_interpretation(path))
