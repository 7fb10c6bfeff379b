"""The method in plain NumPy float64: it follows the paper, and tests compare kernels with it.

Nothing here is fast: every function is the equation it cites, on arrays of shape (…, H, W).
ρ̂ = f·ρ is in px/frame and coordinates are normalised, x̂ = x/f, so that eq. 2 becomes
(u, v)ᵀ = G ρ̂ and the paper's λ becomes λ̂ = λ/f².

Departures from the paper, beyond that scaling:

- eq. 10 on edges: b belongs to the difference of two neighbours, as in eq. 14, so that the
  iteration majorises and minimises one energy exactly;
- a contrast δ in eq. 10: Φ_δ(s) = 2δ²(√(1 + s²/δ²) − 1); the paper has δ = 1 in the units of τ;
- robust weights of the data, gradient constancy, normalised constraints, image-driven edges and
  a stiffness of each component, all as `tisfm.Settings` describes them, none in the paper;
- a warp: frame 1 is brought to frame 0 by the current flow before derivatives are taken;
- occlusion, which the paper does not estimate.

Errata of the paper: the third line of eq. 18 must read s3, not s1; eq. 9 minimises b·a² + ψ(b);
the field b under eq. 8 lists b_τ2 twice, the third is b_τ3; the text on Fig. 6 says that panel (a)
has the larger λ, its caption gives (a) 10⁸ and (b) 10⁹.
"""

from bench.reference.data import brightness_tensor, constancy_constraints, constancy_tensors
from bench.reference.data import data_energy, flow, motion_matrix, residual, robust_energy
from bench.reference.data import robust_tensor, tensors_of
from bench.reference.depth_maps import align_depth_edges, merge_depths, render_depth
from bench.reference.epipolar import displacement, frame_equations, motion_jacobian, motion_system
from bench.reference.epipolar import restrict_to_line
from bench.reference.foreground_fattening import find_fattened
from bench.reference.images import derivatives, hidden_pixels, splat, warp
from bench.reference.linear_system import local_matrices, local_right_sides, sweep_lexicographic
from bench.reference.linear_system import sweep_red_black
from bench.reference.minimisation import Minimisation, energy, flowless_fields
from bench.reference.minimisation import half_quadratic_energy, minimise, minimise_over_flowless
from bench.reference.patch_match import best_mean, improve_planes, plane_cost, plane_disagreement
from bench.reference.patch_match import window_cost
from bench.reference.plane_sweep import (
    aggregate,
    census_cost,
    census_transform,
    matching_cost,
    outline_cost,
)
from bench.reference.pyramid import coarse_to_fine, prolong
from bench.reference.second_order import SecondOrder, anchor_energy, anchor_tensor, line_tensor
from bench.reference.second_order import minimise_second_order, second_order_energy
from bench.reference.second_order import second_order_half_quadratic, second_order_matrices
from bench.reference.second_order import second_order_measures, second_order_residual
from bench.reference.second_order import second_order_sweep, second_order_system
from bench.reference.second_order import second_order_weights
from bench.reference.smoothness import Smoothness, aubert, differences, edge_weights, image_edges
from bench.reference.smoothness import smoothness_energy
from bench.reference.weighted_median import weighted_median
