"""Bytes that each kernel has to move, for its share of the bandwidth.

Every array that a kernel must read or write counts once, 4 bytes per pixel and component, however
often the kernel accesses it; the stream follows the same rule. Halo, padding, column tables, and
reads of cache lines that are then overwritten do not count. So a kernel with two passes over its
arrays reaches at most half the bandwidth.

Only `sweep_unfused`, which shows the cost of two passes, counts the bytes of each pass. They are
whole cache lines; with 16 lanes, a line holds one color only.
"""

from dataclasses import dataclass

from bench.shared.problems import HYPOTHESES

BYTES = 4  # of a float32
LINE = 64  # bytes of a cache line


@dataclass(frozen=True)
class Traffic:
    """Words per pixel: `read[0]` + `read[1]`·n for n unknowns per pixel, and so on.

    `spared` words need not be moved if a vector of lanes fills a cache line.
    """

    read: tuple[float, float]
    written: tuple[float, float]
    spared: tuple[float, float] = (0, 0)

    def bytes_per_pixel(self, components: int, lanes: int) -> float:
        """Return the bytes per pixel of a problem with n = `components` unknowns."""
        fixed, per_unknown = (a + b for a, b in zip(self.read, self.written, strict=True))
        if lanes * BYTES >= LINE:
            fixed, per_unknown = fixed - self.spared[0], per_unknown - self.spared[1]
        return BYTES * (fixed + per_unknown * components)


VIEWS = 2  # number of other frames in kernels of several frames
TRAFFIC = {
    "image_to_lanes": Traffic(read=(1, 0), written=(1, 0)),  # image | lanes
    "lanes_to_images": Traffic(read=(0, 1), written=(0, 1)),  # ρ̂ | images
    "derivatives cube": Traffic(read=(2, 0), written=(3, 0)),  # frames | I_x, I_y, I_t
    "derivatives five_tap": Traffic(read=(2, 0), written=(3, 0)),
    "flow": Traffic(read=(0, 1), written=(2, 0)),  # ρ̂ | u, v
    "warp": Traffic(read=(6, 0), written=(2, 0)),  # taps, u, v | warped, mask
    # ∇I, I_t, u, v, mask | constraints, tensor
    "constancy_constraints": Traffic(read=(6, 0), written=(15, 0)),
    "sweep separate": Traffic(read=(5, 3), written=(0, 1)),  # tensor without J_tt, b, ρ̂ | ρ̂
    "sweep joint": Traffic(read=(7, 1), written=(0, 1)),
    "sweep line": Traffic(read=(5, 0), written=(1, 0)),  # J11, j1, b, D | D
    # For red and for black: tensor, b, ρ̂ | ρ̂. Lines of one color spare tensor | ρ̂ of the other.
    "sweep_unfused joint": Traffic(read=(14, 2), written=(0, 2), spared=(5, 1)),
    # constraints, g, tensor, b, ρ̂, previous | tensor, b, previous
    "update separate": Traffic(read=(17, 4), written=(6, 3)),
    "update joint": Traffic(read=(19, 2), written=(8, 1)),
    # Only J11, j1 and J_tt of the tensor.
    "update line": Traffic(read=(18, 0), written=(6, 0)),
    "prolong": Traffic(read=(0, 0.49), written=(0, 1)),  # ρ̂ on 0.7² of the pixels | ρ̂
    "data_precision": Traffic(read=(6, 3), written=(7, 0)),  # tensor, b, ρ̂ | J, residual, M
    "share_of_data": Traffic(read=(7, 0), written=(1, 0)),  # precision | share
    "motion_fields": Traffic(read=(0, 1), written=(3, 0)),  # ρ̂ | u, v, ‖τ‖
    "image_edges": Traffic(read=(1, 0), written=(2, 0)),  # image | g
    "multiply": Traffic(read=(10, 0), written=(9, 0)),  # factor, constraints | constraints
    "backward_flow": Traffic(read=(4, 0), written=(2, 0)),  # flow, flow sum | backward flow
    # Constraints of both frames, trust, masks, u, v | constraints, tensor.
    "join": Traffic(read=(24, 0), written=(15, 0)),
    "splat": Traffic(read=(3, 0), written=(4, 0)),  # u, v, residual | sums
    "hidden_pixels": Traffic(read=(7, 0), written=(1, 0)),  # u, v, residual, sums | out
    # Arrays of half the density have a quarter of the pixels: tensor, b | tensor, b
    "coarsen_system separate": Traffic(read=(6, 2), written=(1.5, 0.5)),
    "coarsen_system joint": Traffic(read=(8, 0), written=(2, 0)),
    # Words of a sweep | residual.
    "restrict_residual separate": Traffic(read=(5, 3), written=(0, 0.25)),
    "restrict_residual joint": Traffic(read=(7, 1), written=(0, 0.25)),
    "relayout": Traffic(read=(0, 0.25), written=(0, 0.25)),
    "add_correction": Traffic(read=(0, 1.25), written=(0, 1)),  # correction, ρ̂ | ρ̂
    "plane_energy separate": Traffic(read=(5, 5), written=(0, 0)),  # tensor, b, ρ̂, previous, step
    "plane_energy joint": Traffic(read=(7, 3), written=(0, 0)),
    "move_to_minimum": Traffic(read=(0, 3), written=(0, 3)),  # ρ̂, previous, step | the same
    # Second order, D and two slopes: tensor without C, six weights, ρ | ρ
    "second_order_sweep": Traffic(read=(11, 0), written=(3, 0)),
    # p and c of 3 constraints, anchors, g, tensor, weights, ρ, previous | tensor, weights, previous
    "second_order_update": Traffic(read=(23, 0), written=(10, 0)),
    "second_order_coarsen_system": Traffic(read=(9, 0), written=(2.25, 0)),  # tensor, weights
    # Words of a sweep | residual.
    "second_order_restrict_residual": Traffic(read=(11, 0), written=(0.75, 0)),
    "second_order_add_correction": Traffic(read=(3.75, 0), written=(3, 0)),  # correction, ρ | ρ
    # Tensor without C, weights, ρ, previous, step
    "second_order_plane_energy": Traffic(read=(17, 0), written=(0, 0)),
    "displacement": Traffic(read=(2, 0), written=(4, 0)),  # D, labels | flow, direction
    # constraints, flow, direction, D | constraints
    "restrict_to_line": Traffic(read=(14, 0), written=(9, 0)),
    # tensor, flow, direction, D, weight, sums | sums
    "add_depth_terms": Traffic(read=(15, 0), written=(3, 0)),
    "depth_constraint": Traffic(read=(2, 0), written=(2, 0)),  # A, B | p, c
    "squared_residual": Traffic(read=(8, 0), written=(1, 0)),  # tensor, flow | out
    "add_frame": Traffic(read=(10, 0), written=(8, 0)),  # tensor, D, weight, sums | slopes, sums
    "eliminate_depth": Traffic(read=(14, 0), written=(0, 0)),  # slopes of two frames, sums
    "motion_system": Traffic(read=(13, 0), written=(0, 0)),  # constraints, D, labels, b
    # features, guess, weight | costs
    "matching_cost": Traffic(read=(10, 0), written=(len(HYPOTHESES), 0)),
    # two words of both frames | costs
    "census_cost": Traffic(read=(4, 0), written=(len(HYPOTHESES), 0)),
    "census_transform": Traffic(read=(2, 0), written=(1, 0)),  # frame, used pixels | codes
    # codes of four frames, guess, free pixels | costs
    "outline_cost": Traffic(read=(6, 0), written=(len(HYPOTHESES), 0)),
    "score": Traffic(read=(6, 0), written=(4, 0)),  # levels, packed levels, planes | planes
    "improve": Traffic(read=(6, 0), written=(4, 0)),
    "views_score": Traffic(read=(5 + VIEWS, 0), written=(4, 0)),  # levels of each other frame
    "views_improve": Traffic(read=(5 + VIEWS, 0), written=(4, 0)),
    "views_costs": Traffic(read=(5 + VIEWS, 0), written=(VIEWS, 0)),
    "find_fattened": Traffic(read=(3, 0), written=(1, 0)),  # frame, D, matches | out
    "weighted_median": Traffic(read=(4, 0), written=(1, 0)),  # D, frame, pixels | out
    "plane_disagreement": Traffic(read=(8, 0), written=(1, 0)),  # planes of both frames | out
    "best_hypothesis": Traffic(read=(len(HYPOTHESES), 0), written=(1, 0)),
    "rigid_fields": Traffic(read=(2, 0), written=(8, 0)),  # D, labels | flow, ρ̂
    "aggregate": Traffic(read=(1 + len(HYPOTHESES), 0), written=(len(HYPOTHESES), 0)),
}
