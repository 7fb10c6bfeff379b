"""How much memory a kernel has to move: the bytes behind every share of bandwidth.

The rule, for kernels and for the stream alike: every array that a kernel must read or write
counts once, 4 bytes per pixel and component, however often the kernel comes back to it. Not
counted are halo, padding and column tables, and the reads of cache lines about to be overwritten.
So a kernel that passes twice over its arrays stays at half the bandwidth at best.
"""

from dataclasses import dataclass

BYTES = 4  # of a float32


@dataclass(frozen=True)
class Traffic:
    """Words per pixel: `read[0]` + `read[1]`·n are read, and so on, for n unknowns per pixel."""

    read: tuple[float, float]
    written: tuple[float, float]

    def bytes_per_pixel(self, components: int) -> float:
        """Return the bytes a pixel of a problem of n = `components` unknowns has to move."""
        fixed, each = (a + b for a, b in zip(self.read, self.written, strict=True))
        return BYTES * (fixed + each * components)


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
    # constraints, g, tensor, b, ρ̂, previous | tensor, b, previous
    "advance separate": Traffic(read=(17, 4), written=(6, 3)),
    "advance joint": Traffic(read=(19, 2), written=(8, 1)),
    "prolong": Traffic(read=(0, 0.49), written=(0, 1)),  # ρ̂ of 0.7² as many pixels | ρ̂
    "evidence": Traffic(read=(6, 3), written=(7, 0)),  # tensor, b, ρ̂ | J, residual, M
    "splat": Traffic(read=(3, 0), written=(4, 0)),  # u, v, residual | claims
    "defeated": Traffic(read=(7, 0), written=(1, 0)),  # u, v, residual, claims | out
}
