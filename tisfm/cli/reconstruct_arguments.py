"""``tisfm reconstruct``: its arguments."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from tisfm.camera import Camera
from tisfm.cli.frame_options import FrameOptions
from tisfm.cli.shared_options import CameraOptions
from tisfm.errors import InputError
from tisfm.reconstruction.calibration import Calibrate
from tisfm.reconstruction.progress import DepthOf
from tisfm.runtime import Arch
from tisfm.settings import Preset, Settings


@dataclass(kw_only=True)
class Reconstruct:
    """Reconstruct a sequence: one path of the camera, and depth of every frame in its scale.

    SOURCE is a video, a folder of images in order, a quoted glob, or images. DIR receives
    reconstruction.json, path.npz, depth/ and frames/ for tisfm.Reconstruction.load; the path as
    trajectory.txt (TUM: time tx ty tz qx qy qz qw) and poses.txt (KITTI: rows of (R | t), camera to
    world), of the largest piece where the sequence fell into several; with --ply points.ply, a
    coloured point cloud, and with --mesh a surface, of what its keyframes agree on; with --motion
    objects masks/, which thing each pixel belongs to, and objects.json, their paths.
    """

    source: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="SOURCE [SOURCE ...]", help_behavior_hint="(required)"),
    ]
    """A video, a folder, a quoted glob, two or more images in order, or a webcam."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for the results, new or empty, or of an earlier reconstruction, which is replaced."""
    preset: Preset = "balanced"
    """How much effort: fast, balanced or accurate."""
    calibrate: Calibrate | None = None
    """Find the focal length from the frames; or with 'radial' a coefficient of the lens as well,
    whose distortion is removed. By default the focal length is found unless --focal or --camera
    states it; with --calibrate focal, --focal is a first guess."""
    poses: Annotated[Path | None, arg(metavar="FILE")] = None
    """Known poses of the frames that are taken, as TUM or KITTI have them: depth alone is found.
    Those of TUM go by their times where frames have times, else by their order."""
    mask: Annotated[str | None, arg(metavar="MASK")] = None
    """A picture, or a folder of one for every frame: black pixels are ignored everywhere. With
    --motion objects, a folder of pictures with a palette of colours is --labels instead."""
    labels: Annotated[str | None, arg(metavar="LABELS")] = None
    """With --motion objects, what moves, if that is known: a folder of pictures whose values, or
    indices of a palette, are 0 at rest, 1 to 254 for the thing of this id, and 255 where ignored;
    of every frame, or of some that they are called like, from which they are carried to others."""
    motion: Literal["camera", "objects"] = "camera"
    """What moves on its own is left out where it does not fit ('camera'); or found, labelled in
    masks/ and objects.json, and given a path and a depth of its own ('objects')."""
    object_sizes: Annotated[tuple[str, ...], arg(metavar="ID=LENGTH [ID=LENGTH ...]")] = ()
    """With --motion objects, how long things are, by their ids: the longest side of the smallest
    box around each, in the unit of --poses. It sets their scale."""
    depth_of: DepthOf = "all"
    """The frames that depth is found of: all, keyframes alone, or none, for the path alone."""
    scale: Annotated[tuple[int, int, float] | None, arg(metavar="FRAME FRAME DISTANCE")] = None
    """The distance of the camera's places at two frames, by their numbers from 0: the unit."""
    ply: bool = False
    """Write points.ply, a coloured point cloud."""
    mesh: Literal["ply", "glb"] | None = None
    """Write mesh.ply or mesh.glb, a coloured surface; it needs pip install 'tisfm[mesh]'."""
    report: bool = False
    """Write report.html, one page for a browser: summary, path, statuses with advice, pictures."""
    workers: int = 1
    """Processes at a time, each with chunks of frames, which are joined. For motion 'camera'."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Make chunks of frames on the workers of a Dask cluster, such as tcp://10.0.0.1:8786. They
    read SOURCE and write DIR under the same paths."""
    chunk: int | None = None
    """Frames of a chunk, at most: 150 with --workers or --cluster. It changes the result; how many
    workers there are does not."""
    resume: bool = False
    """Go on with the same command, however it was interrupted: with chunks that are complete. What
    is complete already is left as it is."""
    arch: Arch | None = None
    """Where kernels run; by default what the variable TI_ARCH says, or else the CPU."""
    threads: int | None = None
    """Most CPU threads; by default all cores. Results do not depend on it."""
    frames: OmitArgPrefixes[FrameOptions] = field(default_factory=FrameOptions)
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.reconstruct_command import reconstruct

        if not self.source:
            raise InputError(
                "SOURCE is missing: give a video, a folder, a quoted glob or images, as in: "
                "tisfm reconstruct VIDEO -o DIR"
            )
        return reconstruct(
            self.source[0] if len(self.source) == 1 else self.source,
            self.output,
            camera=self._camera(),
            calibrate="nothing" if self.camera.focal == "guess" else self.calibrate,
            settings=Settings.preset(self.preset, motion=self.motion),
            frames=self.frames,
            poses=self.poses,
            mask=self.mask,
            labels=self.labels,
            object_sizes=_sizes(self.object_sizes),
            depth_of=self.depth_of,
            scale=self.scale,
            ply=self.ply,
            mesh=self.mesh,
            report=self.report,
            workers=self.workers,
            cluster=self.cluster,
            chunk=self.chunk,
            resume=self.resume,
            arch=self.arch,
            threads=self.threads,
        )

    def _camera(self) -> Camera | Path | None:
        """Return the camera, its file, or None if its focal length is to be found or guessed."""
        options = self.camera
        if not options.guess("camera"):
            return options.camera()
        stated = (options.center, options.distortion, options.readout)
        if any(value is not None for value in stated) or options.aspect != 1:
            raise InputError(
                "--center, --distortion, --aspect and --readout are of a camera whose focal length "
                "is known: give --focal as well; with --calibrate focal, a guess will do"
            )
        if options.focal == "guess" and self.calibrate not in (None, "nothing"):
            raise InputError("--focal guess is not found from the frames: drop it, or --calibrate")
        return None


def _sizes(given: Sequence[str]) -> dict[int, float]:
    """Return lengths by ids, of words such as 3=4.5."""
    sizes = {}
    for word in given:
        number, _, length = word.partition("=")
        try:
            sizes[int(number)] = float(length)
        except ValueError:
            raise InputError(
                f"--object-sizes has {word!r}: expected ID=LENGTH, such as 3=4.5"
            ) from None
    return sizes
