"""``tisfm export``: its arguments."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg


@dataclass(kw_only=True)
class Export:
    """Write a result in the files that other programs read.

    DIR is what `tisfm reconstruct` or `tisfm run` wrote. FORMAT is, of the path: tum, kitti,
    gltf-camera, chan, and with the frames and points measured in them colmap, colmap-text,
    nerfstudio; of what was seen: ply, glb, mesh-ply, mesh-glb; of the lens: undistortion,
    undistortion-tiff; of every frame: depth-tum, depth-kitti, depth-exr, depth-tiff, depth-pfm,
    depth-dpt, masks; videos: video-depth, video-flow, video-side-by-side, video-anaglyph,
    video-wiggle. A path and a surface are of reconstructions alone, video-flow is of runs. Where a
    sequence fell into pieces, each has a file, that of the largest first.
    """

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """The folder of a reconstruction or a run."""
    to: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="FORMAT")]
    """What to write: give it once for each, or several with commas."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT")]
    """Folder for the files, another than DIR; made if need be. Files of the same name are
    replaced."""
    start: int = 0
    """Number of the first frame that is taken, as DIR counts them, from 0."""
    stop: int | None = None
    """Number of the first frame that is not taken any more; by default all are."""
    step: int = 1
    """Take every STEP-th frame."""
    fps: float | None = None
    """Frames a second, of videos, the moving camera and the times of the path. By default what the
    times of the frames say; where there are none 25, and numbers of frames as times of the path."""
    scale: Annotated[tuple[int, int, float] | None, arg(metavar="FRAME FRAME DISTANCE")] = None
    """The distance of the camera's places at two frames, by their numbers from 0: the unit."""
    disparity: float | None = None
    """Of anaglyphs and the swinging camera: how far the nearest moves against the farthest from one
    view to the other, as a share of the width. By default 0.03, and 0.015 to either side."""
    screen: float | None = None
    """Of the same: the plane of the screen, which stays in place, as a quantile of the depth, 0 for
    the farthest and 1 for the nearest. By default it is half as near as the nearest."""
    screen_depth: float | None = None
    """The same as a depth, in the unit of the result."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.export_command import export

        return export(
            self.folder,
            self.output,
            formats=[name for word in self.to for name in word.replace(" ", "").split(",") if name],
            frames=(self.start, self.stop, self.step),
            frames_per_second=self.fps,
            scale=self.scale,
            disparity=self.disparity,
            screen=self.screen,
            screen_depth=self.screen_depth,
        )
