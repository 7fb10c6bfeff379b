"""Tuned numbers of joints; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class JointSettings:
    """Direct alignment of two pieces of a path."""

    # ends of pieces
    max_gap: int = 4  # frames from the last frame of a piece to the first frame of the next one
    # distances, in frames, from the end of a piece to its frames that are compared with both pieces
    frame_steps: tuple[int, ...] = (0, 1, 2, 4)
    min_points: int = 40  # points that the frames beside a joint show
    max_points: int = 400  # points of a frame that are used
    # patches
    patch_radius: int = 2  # px: a patch has 2 · radius + 1 pixels a side, at every level
    min_contrast: float = 2.0  # grey levels: standard deviation in a patch that is used
    min_level_side: int = 48  # px: longer side of the coarsest level
    # starts
    # largest turn, or shift, between the pieces that is tried, as a share of the frame
    max_turn: float = 0.25
    turn_step: int = 2  # px of the coarsest level between the turns, or shifts, that are tried
    # mean correlation at the coarsest level that is worth a refinement; it was at least 0.46 before
    # the 49 joints below
    min_coarse_score: float = 0.3
    # alignment
    steps: int = 12  # Gauss–Newton steps at a level
    min_step: float = 1e-5  # a smaller step ends a level: relative to the depth, or rad
    noise: float = 1.5  # grey levels: smallest deviation of a patch from its reference
    damping: float = 1e-3  # share of the diagonal that is added to the normal equations
    # acceptance: mean correlation of patches across the joint, over that within the pieces. Of 50
    # joints of rendered and real sequences, with up to two frames lost, 49 had 0.49 to 1.08; of 88
    # pairs of pieces that show different scenes, all had at most 0.3.
    min_score: float = 0.45
    min_own_score: float = 0.4  # mean correlation within the pieces; it was 0.53 to 0.97 there
    max_scale_deviation: float = 0.05  # of the logarithm of the scale
    # score over that of the best alignment: another similarity as good as this is a rival
    min_rival_score: float = 0.85
    max_rivals: int = 2  # shifts of the later piece that are refined in search of a rival
    # median distance, as a share of the longer side of a frame, between the places where a rival
    # and the best alignment show points
    min_rival_distance: float = 0.01
    # rad: turn between the alignments by the patches of one piece, which was at most 0.013 at right
    # joints and 0.12 at a wrong one of the same score
    max_turn_difference: float = 0.025
    max_scale_difference: float = 0.1  # the same of the logarithm of the scale, at most 0.064


JOINTS = JointSettings()
