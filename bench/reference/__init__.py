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

from bench.reference.data import *
from bench.reference.depth_maps import *
from bench.reference.epipolar import *
from bench.reference.images import *
from bench.reference.linear_system import *
from bench.reference.minimisation import *
from bench.reference.patch_match import *
from bench.reference.plane_sweep import *
from bench.reference.pyramid import *
from bench.reference.second_order import *
from bench.reference.smoothness import *
