"""Two frames in, one interpretation out."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tisfm import runtime
from tisfm.camera import Camera, check_camera
from tisfm.confidence import confidence
from tisfm.frames import eight_bit, grey_pair
from tisfm.interpretation import History, Interpretation, Status
from tisfm.lens import Undistortion
from tisfm.occlusion import leaves_image
from tisfm.settings import Settings, check_settings
from tisfm.version import __version__

if TYPE_CHECKING:  # loading it loads Taichi
    from tisfm.pyramid import Solution

RUNAWAY = 0.5  # of the image's longer side: benchmarks have at most 0.12, runaway flow 0.7 and more
MOST_LEAVING = 0.5  # of the pixels: benchmarks have at most 0.08


def interpret(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera | None = None,
    settings: Settings | None = None,
    pose: npt.ArrayLike | None = None,
) -> Interpretation:
    """Interpret two frames: 3D motion, depth and image motion at every pixel of frame 0.

    Parameters
    ----------
    frame0, frame1 : (H, W) or (H, W, 3) array
        Grey or RGB; uint8, uint16 or float, both alike. At least 4 × 4 px. Not modified.
    camera : Camera, optional
        By default a focal length of 600 px, as in the paper, and the image's centre. If it has
        distortion, that is removed from both frames first, and the result is that of frame 0
        without distortion, of the same size, focal length and centre.
    settings : Settings, optional
        By default the preset ``"balanced"``.
    pose : array, optional
        A known motion of the camera. Not used by ``motion="field"``, the only reading of motion
        there is so far: anything but None is refused.

    Returns
    -------
    Interpretation
        Its `camera` is a pinhole. Where the frames without distortion have no data, confidence is
        0 and `occlusion` True.

    Raises
    ------
    TypeError, ValueError
        If a frame is not an image of those kinds, the two differ in size or type, or a pixel is
        NaN or infinite; if `pose` is given; if distortion leaves next to nothing of the frames.

    References
    ----------
    Sekkati, Mitiche, "A variational method for the recovery of dense 3D structure from motion",
    Robotics and Autonomous Systems 55 (2007) 597–607, doi 10.1016/j.robot.2006.11.006.
    """
    camera, settings = check_camera(camera), check_settings(settings)
    if pose is not None:
        raise ValueError('pose is given, but motion="field" leaves the motion free: leave it out')
    grey0, grey1 = grey_pair(frame0, frame1)
    frame = eight_bit(frame0, frame1)

    runtime.start()  # before Taichi is imported, which looks for a cache folder as well
    from tisfm.occlusion import occlusion
    from tisfm.pyramid import Pyramid, coarse_to_fine

    lens = None if camera.distortion is None else Undistortion(camera, *grey0.shape)
    if lens is not None:
        grey0, grey1, frame = map(lens.apply, (grey0, grey1, frame))
        camera = camera.pinhole()
    solution = coarse_to_fine(
        Pyramid(grey0, grey1, camera, settings),
        settings,
        components=settings.components,
        contrast=settings.contrast_for(camera.focal),
    )
    field = solution.field
    rho = np.zeros((6, *grey0.shape), np.float32)
    rho[: field.components] = field.images()
    flow = field.to_images(field.flow(field.grid.allocate(2)))
    with np.errstate(over="ignore", invalid="ignore"):  # where ρ̂ diverged, as the status says
        unseen = occlusion(grey0, grey1, flow, settings)
        if lens is not None:
            unseen |= lens.missing(flow)
        trust = confidence(solution.minimiser.evidence(solution.terms), unseen)
    return Interpretation(
        rho=rho,
        flow=np.ascontiguousarray(np.moveaxis(flow, 0, -1)),
        confidence=trust,
        occlusion=unseen,
        frame=frame,
        camera=camera,
        settings=settings,
        status=_status(solution, flow, settings),
        history=_history(solution),
        version=__version__,
    )


def _status(solution: "Solution", flow: np.ndarray, settings: Settings) -> Status:
    last = solution.history[-1][2]
    # What moves by half the image is hardly seen twice; NaN fails the comparison as well.
    if not np.hypot(*flow).max() <= RUNAWAY * max(flow.shape[1:]):
        return Status(
            "diverged",
            f"image motion grew beyond {100 * RUNAWAY:g}% of the image's longer side: bring the "
            "frames to the 8-bit scale, give data_contrast a value, raise smoothness or contrast, "
            "take frames closer in time, and check the camera's focal length and centre",
        )
    leaving = float(leaves_image(flow).mean())
    if leaving > MOST_LEAVING:
        return Status(
            "diverged",
            f"{100 * leaving:.0f}% of the pixels leave the image, so little is left to compare: "
            "take frames closer in time, check that they are of one scene, or raise smoothness",
        )
    if not solution.minimiser.tensor[:3].any():
        return Status(
            "no_texture",
            "the frames are uniform, so no motion can be seen: check that they are images of a "
            "textured scene",
        )
    if not solution.field.rho.any():
        return Status(
            "no_motion",
            "the frames do not differ, so there is no motion to interpret: take frames further "
            "apart in time",
        )
    if not solution.converged:
        return Status(
            "iteration_limit",
            f"ρ̂ still changed by {last.change:.1e} of its norm in the last of "
            f"{settings.outer_iterations} iterations (tolerance {settings.tolerance:g}): raise "
            "outer_iterations or sweeps, or accept a higher tolerance",
        )
    return Status("converged", f"ρ̂ changed by {last.change:.1e} of its norm in the last iteration")


def _history(solution: "Solution") -> History:
    levels, warps, iterations = zip(*solution.history, strict=True)
    return History(
        level=np.array(levels, np.int32),
        warp=np.array(warps, np.int32),
        **{
            name: np.array([getattr(iteration, name) for iteration in iterations])
            for name in ("energy", "half_quadratic", "change")
        },
    )
