"""The result: 3D motion, depth, image motion and how far to trust them."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from tisfm.camera import Camera
from tisfm.point_cloud import FARTHEST_MEDIANS, PointCloud, point_cloud
from tisfm.settings import Settings
from tisfm.status import History, Status


@dataclass(frozen=True, kw_only=True, eq=False)
class Interpretation:
    """The 3D interpretation of a pair of frames.

    Attributes
    ----------
    rho : (6, H, W) float32
        ρ̂ = f·(τ, ω), px/frame; ω is zero under the translation model.
    flow : (H, W, 2) float32
        Image motion (u, v) of eq. 25, px/frame, u to the right and v down.
    inverse_depth : (H, W) float32
        Relative inverse depth. For ``motion="field"`` it is ‖τ‖ (eq. 24), for ‖T‖ = 1: true where
        the scene translates parallel to the image plane, elsewhere see docs/trust.md. For
        ``motion="camera"`` it is signed, for ‖T‖ = 1, or in the inverse unit of a given pose's
        translation; for ``"objects"`` in that of each label's own T. 0 where there is no depth to
        see: everywhere if the status says so, or on a background that shows no parallax.
    inverse_depth_std : (H, W) float32 or None
        Its standard deviation: about 68% of the pixels that are visible in frame 1 are off by
        less. Infinite where there is no depth, never 0. None for ``motion="field"``.
    confidence : (H, W) float32
        In [0, 1]: how much the data in a window of 15 px around a pixel, not its neighbours'
        motion, determine its image motion. 0 where the pixel is not visible in frame 1.
    occlusion : (H, W) bool
        Where a pixel is not visible in frame 1: it leaves the image, or is hidden there.
    motions : (K, 6) float64 or None
        Twists (T, ω) of the rigid motions, per frame, with ‖T‖ = 1, or, with `align_scales`, in
        the unit of the background's. `tisfm.rigid.rigid_motion` gives R and t of P₁ = R P₀ + t. T
        is 0 where the camera only turned or did not move. None for ``motion="field"``.
    labels : (H, W) int32 or None
        Which of `motions` a pixel has. None for ``motion="field"``.
    frame : (H, W) or (H, W, 3) uint8
        Frame 0, on the 8-bit scale, without distortion and what a stated readout moved: what a
        picture of the result is drawn on.
    camera : Camera
        The pinhole camera that all of this belongs to: without distortion. Its readout is 0 where
        it was undone.
    settings : Settings
    status : Status
        A code that compares as text, with ``status.message`` saying what to try.
    history : History
        Energy and relative change of every iteration.
    version : str
        Version of tisfm that computed it.

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
        """Relative depth, (H, W) float32; NaN where the inverse depth is not above 0."""
        depth = np.full_like(self.inverse_depth, np.nan)
        np.divide(1, self.inverse_depth, out=depth, where=self.inverse_depth > 0)
        return depth

    def points(
        self,
        *,
        min_confidence: float = 0.0,
        max_depth: float | None = FARTHEST_MEDIANS,
        occluded: bool = False,
    ) -> PointCloud:
        """Return the scene as coloured points, one for every pixel with a depth.

        Parameters
        ----------
        min_confidence : float
            In [0, 1]: pixels of less confidence are left out.
        max_depth : float or None
            Pixels farther than so many median depths (of the other pixels that are taken) are
            left out: where the inverse depth is nearly 0 the depth is a guess. None for no limit.
        occluded : bool
            Whether to take pixels that are not visible in frame 1 as well: their depth is that of
            their neighbours.

        Returns
        -------
        PointCloud
            Used as an array it is (N, 3) float32: X right, Y down, Z forward, in the axes of the
            camera at frame 0 and the relative scale of `depth`. With ``colors``, ``confidence``,
            and ``save(path)`` for a PLY file. It may have no points.

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
        return point_cloud(
            self.depth,
            self.camera,
            frame=self.frame,
            confidence=self.confidence,
            occlusion=self.occlusion,
            min_confidence=min_confidence,
            max_depth=max_depth,
            occluded=occluded,
        )

    def save(self, path: str | Path, *, compact: bool = False) -> None:
        """Write everything to an ``.npz`` without pickles, whole or not at all.

        What `load` gives back is the same but for two roundings: `rho`, and with it `tau` and
        `omega`, to 11 significant bits (and to 6e-8 px/frame where it is tiny), and `confidence`
        to 11 bits as well. Numbers of `rho` beyond 65504, as a result that diverged may have, are
        kept as they are. `numpy.load` reads the file too; ``docs/formats.md`` describes it.

        A compact file, as `tisfm run` writes it, has a quarter of the bytes, and rounds more:
        `flow`, `rho` and `confidence` to multiples of 2⁻¹⁰ (of px/frame; or, where all of them are
        small, of at most 2⁻¹² of the largest), inverse depth and its deviation to 12 significant
        bits. Arrays in it are packed, but for a result that diverged.

        Parameters
        ----------
        path : path
            The file; ``.npz`` is the customary suffix, and none is added.
        compact : bool, default False
            Whether to round more, and to compress.

        Raises
        ------
        OSError
            If the folder does not exist or cannot be written to.
        ValueError
            If a value is masked, or if `load` would refuse what is written: if arrays do not fit
            each other, or hold NaN or infinity though the status is another than ``"diverged"`` or
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
        """Read what `save` wrote.

        Nothing in the file is run, and every shape, type and name is checked before an array is
        read. Of a compact file no more is unpacked than the arrays that it states, of at most 2²⁴
        pixels, or as many as the file has bytes.

        Raises
        ------
        FileNotFoundError, IsADirectoryError, OSError
            If there is no such file, or it cannot be read.
        tisfm.formats.FormatError
            A ValueError: if it is not a complete interpretation, or of a format this version
            cannot read.
        MemoryError
            If it is one, but memory does not suffice.

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
