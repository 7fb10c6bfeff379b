"""The cause of missing poses, from measures of images and tracks, as a status."""

from tisfm.reconstruction.causes.image_measures import ImageMeasures
from tisfm.reconstruction.causes.settings import CAUSES
from tisfm.reconstruction.causes.track_measures import TrackMeasures
from tisfm.reconstruction.rotation.settings import ROTATION
from tisfm.status import Status

# Causes that mislead tracks, rather than end them.
MISLEADING_CAUSES = ("fixed_pattern", "noise", "changing_light")


def explain_images(images: ImageMeasures, tracks: TrackMeasures) -> Status | None:
    """Return what the images show against a path, as a status; None for nothing."""
    if images.structure < CAUSES.min_contrast:
        return Status("no_texture", _describe_texture(images))
    if (
        images.fixed_correlation > CAUSES.max_fixed_correlation
        and images.coarse_correlation < CAUSES.max_coarse_correlation
    ):
        return Status(
            "fixed_pattern",
            f"a pattern with a standard deviation of {images.noise:.0f} grey levels is fixed on "
            "the sensor, and hides the motion. Subtract it, such as the mean of many frames, or "
            "mask it",
        )
    if images.light_change > CAUSES.max_light_change:
        return Status(
            "changing_light",
            f"the brightness changes by {100 * images.light_change:.0f} % from frame to frame, and "
            "hides the motion. Lock the exposure, avoid lamps that flicker, or even out the frames",
        )
    if images.noise > CAUSES.max_noise_share * images.contrast and (
        tracks.survival < CAUSES.min_noise_survival or images.texture < CAUSES.min_textured_blocks
    ):
        return Status(
            "noise",
            f"noise with a standard deviation of {images.noise:.0f} grey levels hides the motion: "
            f"the contrast is {images.contrast:.0f}. Give more light, a longer exposure, or "
            "smaller frames (size, --size)",
        )
    if images.sharpness < CAUSES.min_sharpness or images.texture < CAUSES.min_textured_blocks:
        return Status("no_texture", _describe_texture(images))
    if images.repetition > CAUSES.max_repetition:
        return Status(
            "repeated_texture",
            "the texture repeats itself, as tiles or a fence do: it shows no motion without doubt. "
            "Show other things too, or take frames closer in time",
        )
    return None


def _describe_texture(images: ImageMeasures) -> str:
    """Return why frames have too little texture, and what to do."""
    share = f"only {100 * images.texture:.0f} % of the frame has texture"
    if images.brightness < CAUSES.min_brightness:
        return f"the frame is dark: {share}. Give more light, or a longer exposure"
    if images.structure >= CAUSES.min_contrast and images.sharpness < CAUSES.min_sharpness:
        return "the frame is blurred: it has no fine texture. Move more slowly, or focus the lens"
    return f"the frame is bare: {share}. Show textured surfaces"


def explain_motion(
    tracks: TrackMeasures,
    *,
    is_focal_known: bool,
    # whether frames in which the camera clearly turns have orientations: then one plane is left as
    # the explanation
    are_turns_found: bool = True,
) -> Status:
    """Return what the tracks show against a path, as a status."""
    if tracks.motion < ROTATION.min_motion:
        return Status(
            "little_parallax",
            f"the camera hardly moves: the image moves by {100 * tracks.motion:.1g} % of its "
            "longer side at most. Take frames farther apart (--step), or move the camera",
        )
    if tracks.homography <= CAUSES.max_plane_residual and not are_turns_found:
        return Status(
            "little_parallax",
            "the camera only turns, or the scene is one plane: both look alike. A stream finds no "
            "orientations: take the frames as a sequence (tisfm.reconstruct), or move the camera "
            "sideways",
        )
    if tracks.homography <= CAUSES.max_plane_residual and not is_focal_known:
        return Status(
            "one_plane",
            "the scene is one plane, or the camera turns by a small angle: both look alike with an "
            "unknown focal length. Give the focal length (--focal), or show other depths",
        )
    if tracks.homography <= CAUSES.max_plane_residual:
        return Status(
            "little_parallax",
            "the camera hardly changes its position: one plane explains the motion up to "
            f"{tracks.homography:.1f} px. Check the given focal length, or move the camera "
            "sideways",
        )
    return Status(
        "little_parallax",
        "no two frames show enough parallax to begin a path, or nothing fits them: several "
        "motions, a lens that distorts, or a wrong focal length. Move the camera sideways, mask "
        "what moves, or check the camera",
    )
