"""Second-order smoothness of inverse depth: total generalised variation.

The unknowns of a pixel are D, in px/frame of the finest level, and its slopes v₁ and v₂ to the
east and to the south, per pixel of that level. The energy is

    Σ_p [A D² + 2 B D + C] + Σ_edges a r² + b |Δv|² + c (ΔD)²,
    r = D_N − D − h (v_p + v_N)/2,

with v₁ in r on eastern edges and v₂ on southern edges, and h the spacing of the grid in pixels of
the finest level. r = 0 on every edge of a plane, and of a quadric with its slopes. The weights are
a = α g b_r, b = β g b_v and c = γ g b_D; every half-quadratic iteration computes them anew.

References: Bredies, Kunisch and Pock, "Total generalized variation", SIAM Journal on Imaging
Sciences 3 (2010) 492–526, doi 10.1137/090769521.

Here: sweeps, coarsening and interpolation, line search, weight update.
May import: `tisfm.kernels.layout`, `tisfm.kernels.model` and `tisfm.kernels.solve`.
"""
