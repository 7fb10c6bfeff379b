"""Tuned numbers of the causes of missing poses; without another source, set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CauseSettings:
    """Measures of images and of tracks, and their limits.

    The comments give the measures of 30 films that have a path, and of the films that have none
    because of the cause.
    """

    max_frames: int = 8  # frames that are measured, each with the next frame
    # image_measures; px of frames that were shrunk for flow
    noise_block: int = 16  # px: side of the blocks whose noise and texture are measured
    noise_quantile: float = 0.1  # of the blocks: others have texture
    detail_blur: float = 1.5  # px: blur that removes most of the noise before texture is measured
    blurred_noise: float = 0.19  # share of white noise that this blur keeps: 1 / (2 √π · 1.5)
    # grey levels: standard deviation of the blurred grey levels in a block with texture
    min_block_texture: float = 2.0
    min_texture_to_noise: float = 3.0  # the same, over the noise that is left
    light_blocks: tuple[int, int] = (12, 16)  # blocks of a frame, rows and columns
    patch_side: int = 7  # px: side of the patches whose brightness is compared along tracks
    min_compared_tracks: int = 10  # tracks of two frames that show a change of light
    coarse_blur: float = 4.0  # px: blur that leaves no fixed pattern
    sharp_blur: float = 2.0  # px: blur that a sharp frame differs from
    repetition_blur: float = 8.0  # px: coarser structure is removed
    max_repetition_move: float = 0.33  # of a side: larger moves leave too little to compare
    min_repetition_variance: float = 1.0  # grey levels, squared: less is no texture
    min_deviation: float = 1e-6  # grey levels: of a frame with one grey level
    min_repetition_distance: float = 8.0  # px between a texture and its repetition
    # cause
    max_noise_share: float = 0.25  # noise over contrast: 0.002–0.17 with a path, 0.47 without
    max_light_change: float = 0.12  # 0.00–0.08 with a path, 0.20 to 0.40 without
    max_fixed_correlation: float = 0.3  # −0.15–0.05 with a path, 0.87 to 0.96 with a fixed pattern
    max_coarse_correlation: float = 0.95  # coarse structure of frames of a camera that moves
    max_repetition: float = 0.75  # 0.07–0.67 with a path, 1.0 in front of tiles
    min_textured_blocks: float = 0.15  # share of the blocks of a frame
    min_contrast: float = 5.0  # grey levels, without noise: a bare wall has less
    min_sharpness: float = 0.04  # 0.07–0.79 with a path, 0.01 to 0.03 of blurred frames
    min_light_survival: float = 0.3  # share of tracks that go on: fewer tracks follow the light
    min_brightness: float = 20.0  # mean grey level of a frame that is not dark
    min_noise_survival: float = 0.6  # share of tracks that go on although there is noise
    max_plane_residual: float = 1.0  # px of 640: residual of a homography in front of one plane
    # smaller share of a frame's tracks that go on: the scene changed, as at a cut
    max_cut_survival: float = 0.1
    min_broken_pairs: int = 3  # pairs of frames at which tracks end: more than cuts would break
    min_broken_share: float = 0.5  # and share of the measured pairs


CAUSES = CauseSettings()
