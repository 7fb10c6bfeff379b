"""The result: 3D motion, depth, image motion and how far to trust them."""

import io
import json
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.point_cloud import FARTHEST, PointCloud, point_cloud
from tisfm.settings import Settings
from tisfm.visibility.occlusion import leaves_image

FORMAT = 5  # of the .npz; raised when a reader of the one before would go wrong


class Status(str):
    """A short code that says how the interpretation ended, with a message on what to try.

    Codes: ``"converged"``; ``"iteration_limit"``, the unknowns still evolved when the iterations
    ran out; ``"no_motion"``, the frames are identical; ``"no_texture"``, frame 0 shows no
    gradient that motion could be seen by; ``"diverged"``, the numbers are of no use: somewhere the
    image motion grew beyond half of the image's longer side, or more than half of the pixels leave
    the image. With ``motion="camera"``, or ``"objects"`` that find one motion only, also
    ``"pure_rotation"``, the camera only turned, ``"little_parallax"``, it hardly changed its place,
    and ``"unrelated"``, the frames have nothing in common: there is no depth. With a pose given,
    ``"pose_mismatch"``: it contradicts the images, and the depth is what follows from it all the
    same.
    """

    message: str

    def __new__(cls, code: str, message: str = "") -> "Status":
        """Make a status that compares equal to its code."""
        status = super().__new__(cls, code)
        status.message = message
        return status


@dataclass(frozen=True, kw_only=True)
class History:
    """Record of every half-quadratic iteration, in order; arrays of one length.

    Attributes
    ----------
    level : (N,) int32
        Level of the pyramid, 0 the finest.
    warp : (N,) int32
        Linearisation within the level.
    energy : (N,) float64
        Energy (eq. 6, 20) after the iteration; within a warp it never rises.
    half_quadratic : (N,) float64
        Its half-quadratic form (eq. 8, 21) with the weights the iteration used.
    change : (N,) float64
        ‖change of ρ̂‖ / ‖ρ̂‖.
    """

    level: np.ndarray
    warp: np.ndarray
    energy: np.ndarray
    half_quadratic: np.ndarray
    change: np.ndarray


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
        the scene translates parallel to the image plane, elsewhere see the README. For
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
        Where a pixel is not visible in frame 1: it leaves the image, or is hidden there. After
        `load` of a file of format 1, which has no such map, only what leaves the image.
    motions : (K, 6) float64 or None
        Twists (T, ω) of the rigid motions, per frame, with ‖T‖ = 1, or, with `align_scales`, in
        the unit of the background's. `tisfm.rigid.rigid_motion` gives R and t of P₁ = R P₀ + t. T
        is 0 where the camera only turned or did not move. None for ``motion="field"``.
    labels : (H, W) int32 or None
        Which of `motions` a pixel has. None for ``motion="field"``.
    frame : (H, W) or (H, W, 3) uint8
        Frame 0, on the 8-bit scale and without distortion: what a picture of the result is drawn
        on.
    camera : Camera
        The pinhole camera that all of this belongs to: without distortion.
    settings : Settings
    status : Status
        A code that compares as text, with ``status.message`` saying what to try.
    history : History
        Energy and relative change of every iteration.
    version : str
        Version of tisfm that computed it.
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
        max_depth: float | None = FARTHEST,
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

    def save(self, path: str | Path) -> None:
        """Write everything to a compressed ``.npz`` without pickles, whole or not at all.

        Parameters
        ----------
        path : path
            The file; ``.npz`` is the customary suffix, and none is added.

        Raises
        ------
        OSError
            If the folder does not exist or cannot be written to.
        """
        from tisfm.formats import atomic_write

        arrays = {name: getattr(self, name) for name in (*_ARRAYS, *_OPTIONAL)}
        arrays = {name: array for name, array in arrays.items() if array is not None}
        record = {f"history_{name}": array for name, array in vars(self.history).items()}
        about = {
            "format": FORMAT,
            "version": self.version,
            "camera": asdict(self.camera),
            "settings": asdict(self.settings),
            "status": str(self.status),
            "message": self.status.message,
        }
        with atomic_write(path) as file:
            np.savez_compressed(file, about=np.array(json.dumps(about)), **arrays, **record)

    @classmethod
    def load(cls, path: str | Path) -> "Interpretation":
        """Read what `save` wrote.

        Files of older formats are read as well. Those of format 1 know neither `coarse_warps`,
        which was that of `warps`, nor what is hidden: `occlusion` then is what leaves the image.

        Raises
        ------
        FileNotFoundError, IsADirectoryError, OSError
            If there is no such file, or it cannot be read.
        tisfm.formats.FormatError
            A ValueError: if it is not a complete interpretation, or of a format this version
            cannot read.
        """
        from tisfm.formats import FormatError
        from tisfm.formats.reading import read_bytes

        data = read_bytes(path)
        try:
            if not data.startswith(b"PK"):
                raise ValueError("it is not an .npz file")
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                return cls._from_arrays({name: file[name] for name in file.files})
        except Exception as error:  # the decoders raise whatever a damaged file leads them to
            reason = " ".join(str(error).split())
            raise FormatError(
                f"{path} is not a complete interpretation written by tisfm: {reason}"
            ) from error

    @classmethod
    def _from_arrays(cls, data: dict[str, np.ndarray]) -> "Interpretation":
        about: dict[str, Any] = json.loads(str(data["about"])) if "about" in data else {}
        if about and about["format"] not in range(1, FORMAT + 1):
            raise ValueError(
                f"its format is {about['format']} and this version reads 1 to {FORMAT}: "
                f"it was written by tisfm {about['version']}"
            )
        if about and about["format"] < FORMAT:
            _bring_up_to_date(data, about)
        missing = {"about", *_ARRAYS}.difference(data)
        if missing:
            raise ValueError(f"it has no {', '.join(sorted(missing))}")
        _check_names(about["settings"])
        height, width = data["frame"].shape[:2]
        expected = {
            "rho": ((6, height, width), np.float32),
            "flow": ((height, width, 2), np.float32),
            "inverse_depth": ((height, width), np.float32),
            "inverse_depth_std": ((height, width), np.float32),
            "labels": ((height, width), np.int32),
            "confidence": ((height, width), np.float32),
            "occlusion": ((height, width), np.bool_),
        }
        if "motions" in data:
            expected["motions"] = ((len(data["motions"]), 6), np.float64)
        for name, (shape, kind) in expected.items():
            if name in _OPTIONAL and name not in data:
                continue
            if data[name].shape != shape or data[name].dtype != kind:
                raise ValueError(
                    f"{name} is {data[name].shape} {data[name].dtype}, expected {shape} "
                    f"{np.dtype(kind).name}"
                )
        camera = about["camera"]
        if camera["center"] is not None:
            camera["center"] = tuple(camera["center"])
        history = {
            name.removeprefix("history_"): array
            for name, array in data.items()
            if name.startswith("history_")
        }
        return cls(
            **{name: data[name] for name in (*_ARRAYS, *_OPTIONAL) if name in data},
            camera=Camera(**camera),
            settings=Settings(**about["settings"]),
            status=Status(about["status"], about["message"]),
            history=History(**history),
            version=about["version"],
        )


def _bring_up_to_date(data: dict[str, np.ndarray], about: dict[str, Any]) -> None:
    """Add what older formats lack to arrays and settings, in place; they may have some of it."""
    settings = about["settings"]
    if about["format"] == 1:
        if "flow" in data:
            data.setdefault("occlusion", leaves_image(np.moveaxis(data["flow"], -1, 0)))
        if "warps" in settings:
            settings.setdefault("coarse_warps", settings["warps"])
    if "rho" in data:
        tau = data["rho"][:3] / np.float32(about["camera"]["focal"])
        data.setdefault("inverse_depth", np.sqrt(np.einsum("khw,khw->hw", tau, tau)))
    settings.setdefault("cycles", 0)
    settings.setdefault("finest_level", 0)
    # They were not in use: files of formats 1 and 2 hold motion="field".
    for name in (
        "depth_smoothness",
        "depth_brightness",
        "depth_normalization",
        "max_objects",
        "align_scales",
    ):
        settings.setdefault(name, getattr(Settings(), name))


def _check_names(settings: dict[str, Any]) -> None:
    """Refuse settings that lack one, which must not take a default of today, or have another."""
    known = {setting.name for setting in fields(Settings)}
    for names, fault in (
        (known.difference(settings), "its settings lack"),
        (set(settings).difference(known), "its settings have the unknown"),
    ):
        if names:
            raise ValueError(f"{fault} {', '.join(sorted(names))}")


_ARRAYS = ("rho", "flow", "inverse_depth", "confidence", "occlusion", "frame")
_OPTIONAL = ("inverse_depth_std", "motions", "labels")
