"""Numbers of the search for a change of light, for another camera, and for fixed pixels."""

from dataclasses import dataclass

from tisfm.errors import InputError


@dataclass(frozen=True, kw_only=True)
class LightSettings:
    """Changes of light between two frames."""

    # longer sides: standard deviation of the Gaussian that averages over a region
    region: float = 0.06
    min_trust: float = 0.3  # confidence of the flow of pixels that are compared
    min_used_share: float = 0.05  # share of such pixels
    min_region_share: float = 0.15  # share of such pixels in a region that is judged
    large_percentile: int = 90  # percentile of regions that counts as the largest change
    # grey levels: median change of regions, and this percentile, from which light is corrected;
    # rendered pairs in constant light have at most 0.12 and 0.6
    min_typical_change: float = 0.5
    min_large_change: float = 1.5
    # grey levels: the same, from which the flow field is estimated again
    min_typical_change_of_flow: float = 2.0
    min_large_change_of_flow: float = 5.0
    # change that the next flow field shows divided by the first change: if the rest is larger, the
    # flow field was wrong, and light is not corrected
    max_rest: float = 0.5
    samples: int = 4000  # pixels that the change of the whole frame is fitted to
    iterations: int = 8  # iterations of this fit
    min_noise: float = 0.5  # grey levels: smallest scale of a robust fit
    prior_weight: float = 0.02  # weight of a gain of 1 in regions, as a share of all pixels' weight
    max_gain: float = 4.0  # largest change of light, and 1/(the smallest)


@dataclass(frozen=True, kw_only=True)
class IntrinsicsSettings:
    """Whether another camera explains a flow field better."""

    max_rays: int = 200  # rays that are compared
    independent_rays: int = 30  # rays with independent errors; neighbours share errors of the flow
    min_residual: float = 0.02  # px of the level: smaller residuals are equally good
    weight_behind: float = 0.2  # weight of points behind the camera
    # values that are tried with both signs: logarithm of the focal length, logarithm of the zoom
    # from frame 0 to frame 1, and k₁
    focal_values: tuple[float, ...] = (0.15, 0.3, 0.45, 0.6, 0.9)
    zoom_values: tuple[float, ...] = (0.005, 0.01, 0.02, 0.04, 0.08)
    distortion_values: tuple[float, ...] = (0.04, 0.08, 0.16, 0.32, 0.6)
    # standard deviations of the priors of these values
    focal_prior: float = 0.5
    zoom_prior: float = 0.05
    distortion_prior: float = 0.3
    max_overshoot: float = 1.2  # largest value of a fit over the largest value that is tried
    undistortion_iterations: int = 8  # Newton's iterations of the radius without distortion
    min_distortion_slope: float = 0.1  # smallest derivative of the distorted radius
    max_undistortion: float = 3.0  # largest factor of a point without the distortion
    # steps of the values in which motions far from the stated camera's are improved; at the end,
    # all motions are improved once more
    other_iterations: int = 3
    joint_iterations: int = 6  # iterations of motion and value, from the best value
    min_joint_step: float = 0.05  # deviations of the values: shorter steps end these iterations
    # standard deviations of a value from 0, and by which it explains the rays better
    min_significance: float = 2.5
    min_gain: float = 2.3
    # median relative change of depth, and change of direction, rad, by this value that matter
    min_depth_change: float = 0.03
    min_direction_change: float = 0.14
    # squared standard deviations by which an allowed focal length may explain rays worse
    max_allowed_cost: float = 4.0
    # logarithms of the focal length over the stated one: errors of a stated focal length, and
    # errors that change depth in proportion
    max_wrong_focal: float = 0.5
    max_wrong_guess: float = 0.9  # the same of a guess
    max_linear_focal: float = 0.35
    max_focal_deviation: float = 0.15  # relative: of an estimate in place of a guess
    max_depth_effect: float = 1.0  # relative change of depth over that of the focal length
    # relative change of depth, and change of direction, rad, that a user has to know of
    max_depth_change: float = 0.10
    max_direction_change: float = 0.14
    max_rotation_change: float = 0.035  # rad, by such a focal length
    # degrees: standard deviation of the direction of motion; right pairs have at most 3.8, wrong
    # pairs 4.5 and more
    max_direction_deviation: float = 4.3
    min_direction_residual: float = 0.005  # px of the level: smaller residuals count as this
    turn_iterations: int = 8  # iterations of the fit of a turn
    # residual over that of the iteration before, above which more iterations are useless
    max_turn_gain: float = 0.99
    min_turn_step: float = 1e-4  # rad, and in both parameters: a shorter step ends this fit
    turn_degree: int = 3  # degree of the polynomials that turns are nearly
    # standard deviations of the logarithm of the focal length and of k₁ in this fit, and their
    # largest value
    turn_deviations: tuple[float, float] = (0.5, 0.3)
    max_turn_parameter: float = 1.0
    # residual of a turn with any camera divided by that of the motion: at most 1.7 for turns, 4.1
    # and more if the camera moved
    max_turn_residual: float = 2.5
    min_turn_residual: float = 0.01  # px of the level: smaller residuals count as this
    # residual of this turn divided by the parallax that the stated camera needs
    max_turn_share: float = 0.35
    # misfit
    regions: int = 10  # regions along the longer side
    misfit_percentile: int = 75  # percentile of regions that is judged
    min_rays_of_region: int = 8  # rays of a region that is judged
    min_parallax: float = 0.05  # px of the level: smaller parallax of a region counts as this
    # distance from epipolar lines divided by parallax: at most 0.16 of right pairs
    max_misfit: float = 0.17

    def __post_init__(self) -> None:
        counts = {len(self.focal_values), len(self.zoom_values), len(self.distortion_values)}
        if len(counts) > 1:
            raise InputError(
                f"focal_values has {len(self.focal_values)} values, zoom_values "
                f"{len(self.zoom_values)} and distortion_values {len(self.distortion_values)}: "
                "all three must have the same number"
            )


@dataclass(frozen=True, kw_only=True)
class FixedPixelSettings:
    """Pixels that are fixed on the sensor, in px of the level of the first flow field."""

    window: int = 7  # px: side of the window that averages texture and its change
    min_slope: float = 4.0  # grey levels per px: texture that would show a motion
    max_shift: float = 0.2  # px: change of texture that counts as rest
    # px, and deviations of the flow: distance of a pixel at rest from where it may move
    min_distance: float = 0.75
    min_deviations: float = 5.0
    # shares of the textured pixels that are fixed, if some are; with more, the camera is at rest
    min_share: float = 0.02
    max_share: float = 0.6
    gap: int = 9  # px: gaps between fixed pixels that are closed
    border: int = 4  # px from the lower border: regions that touch it
    min_area: float = 0.01  # share of the frame: smallest region at the lower border
    flow_step: int = 4  # px between pixels that give the typical depth
    min_motion: float = 0.5  # px: motion above such a region, and expected in it


LIGHT = LightSettings()
INTRINSICS = IntrinsicsSettings()
FIXED = FixedPixelSettings()
