"""Tuned numbers of the camera path; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class RevisionSettings:
    """When a path is solved again with a richer camera, and when that path is kept.

    The limits of costs were chosen on rendered films of a room that zoom by 0.25, 0.5, 2 % and not
    at all, and checked on other films and on real sequences of one camera without distortion: with
    a richer camera, the cost of these sequences was 0.95 to 0.99 of the cost with one pinhole; that
    of a film that zooms by 0.25 % a frame was 0.88.
    """

    min_views: int = 4  # views of a piece whose camera is revised
    # frames that show whether one camera suffices, in a piece with fewer views than `min_views`: a
    # street that zooms by 2 % a frame had 3; in 8 of its frames, the zoom is 7 deviations better
    min_frames: int = 8
    window_frames: int = 24  # frames that are adjusted together
    base_steps: int = 8  # steps of an adjustment with one camera; the path is near its optimum
    rich_steps: int = 15  # and with a richer camera
    # robust cost with a richer camera over that with one: with less, the path is solved again
    max_cost: float = 0.93
    # the same ratio, if the path explains few matches: rendered films with a distortion of 27 to
    # 38 % at the corner had 0.92 to 0.944, and a street with cars, which explain few matches
    # without any distortion, 0.97
    max_cost_of_poor_path: float = 0.95
    zoom_rounds: int = 3  # rounds in which the zoom is found, and the path solved
    zoom_tolerance: float = 0.015  # logarithm: a smaller change of the zoom ends the rounds
    # logarithm: largest standard deviation of the zoom of a frame; a forward motion over little
    # relief has 0.05 and more, as it looks like a zoom
    max_zoom_deviation: float = 0.03
    min_zoom: float = 0.015  # logarithm: extent of the zoom of a sequence
    min_zoom_significance: float = 6.0  # standard deviations of this extent
    # robust cost with a zoom over that with a constant focal length and distortion
    max_zoom_cost: float = 0.95
    # the same ratio on the tracks of the first path, if the focal length is stated: ten rendered
    # films with a zoom had 0.27 to 0.94, and deviations of their zoom up to 0.014; 23 sequences
    # with another fault had 0.98 to 2.5, but for five with 0.60 to 0.96
    max_first_zoom_cost: float = 0.97
    # logarithm: difference of the focal length that the tracks show from a stated one
    max_focal_change: float = 0.05
    max_focal_deviations: float = 4.0  # standard deviations of this difference
    # hidden_zoom
    # standard deviations by which a richer camera fits better: with less, no zoom is compared;
    # streets without a zoom have 3 to 4, and with 2 % a frame 5.8 to 8
    min_rich_gain: float = 4.5
    # logarithms of zooms per frame that are compared with a constant focal length, in and out; each
    # adjustment starts from the last one, so the small zooms lead to the large one
    hidden_zoom_rates: tuple[float, ...] = (0.005, 0.01, 0.02)
    hidden_zoom_steps: int = 25  # steps of each adjustment
    # Standard deviations by which a zoom fits better than none: three rendered streets and a
    # real drive without a zoom have at most 2.0, and streets with 2 % a frame 3.8 to 7.
    min_hidden_gain: float = 3.0
    # lens_revision
    # displacements at the corner of the frame, as shares of its radius, of the distortions that are
    # tried first
    weak_lens_starts: tuple[float, ...] = (-0.1, 0.1)
    # the same for distortions that are tried if a weak one fits better than none
    strong_lens_starts: tuple[float, ...] = (-0.25,)
    # Robust cost with a weak distortion over that without: with more, no strong one is tried. Set
    # by hand: a room with a lens has 0.45 to 0.47 with every start, and 65 cases of bench.trust
    # keep their verdicts.
    max_weak_lens_cost: float = 0.95
    lens_rounds: int = 1  # times that the path is solved again with the adjusted distortion
    min_displacement: float = 0.015  # smallest displacement of a distortion that is removed
    min_lens_significance: float = 6.0  # standard deviations of the coefficient
    # robust cost with a distortion over that without: four lenses had 0.45 to 0.69, and a board
    # that moves in front of the scene 0.88
    max_distorted_cost: float = 0.8
    # robust cost with a distortion over that with another focal length
    max_lens_cost: float = 0.95


REVISION = RevisionSettings()


@dataclass(frozen=True, kw_only=True)
class PoseDeviationSettings:
    """Standard deviations of poses."""

    # Factors for errors that tracks share, which their residuals do not show. They were chosen on
    # paths of half A of bench.trust. On 45 of half B, 74 % (position) and 72 % (rotation) of the
    # errors are within one deviation, and 92 and 91 % within two.
    position_factor: float = 1.1
    rotation_factor: float = 1.0
    # frames whose covariance is found together: memory grows like its square, time like its cube
    max_frames: int = 300
    min_tracks: int = 8  # tracks of a frame that has deviations
    # depth_frames, depth_tracks: largest number of frames, and of tracks of a frame, whose depth
    # shows the effect of the poses; it is interpolated between these frames
    depth_frames: int = 50
    depth_tracks: int = 40
    # share of the median depth of a frame: nearer points, and those behind it, do not show the
    # effect of the poses on depth
    min_depth: float = 0.05
    # over the median deviation of relative depths in a frame: those with more do not count for
    # the factor that all share
    max_depth_change: float = 3.0
    # share of the diagonal that is added to it: tracks do not show the scale of the path, and the
    # matrix could not be inverted
    min_stiffness: float = 1e-9
    # size of a motion of the whole path, relative to the largest one, that moves its positions; a
    # turn about a straight path moves none
    min_motion: float = 1e-6


POSE_DEVIATION = PoseDeviationSettings()
