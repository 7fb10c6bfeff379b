"""Synthetic frame pairs with exact truth: textured planes and boxes in rigid motion, ray-cast.

Axes are the camera axes of frame 0: X right, Y down, Z forward. All lengths are in one unit, which
is free to choose. A motion is a twist (T, ω) per frame: a point P has velocity T + ω × P (eq. 1-2
of the paper) and moves, from one frame to the next, by the exact exponential of the twist, P1 = R
P0 + t. A camera that moves by (V, Ω) in its own axes sees a static scene with T = -V, ω = -Ω.

Grey levels are painted on the surfaces, so brightness constancy holds exactly up to anti-aliasing
and quantisation. Textures are band-limited, with wavelengths in scene units: images of different
sizes show the same texture, but waves that are too short for the pixels fade out. The predefined
scenes add octaves of shorter waves for larger images, unless `detail` gives their number.

May import: of the top level `camera`, `checks` and `rigid`.
"""

from tisfm.rigid import rigid_motion

from .block_scenes import STATIC_KINDS, bare_patches, static_scene, three_blocks, two_blocks
from .bodies import BodiesFilm, bodies_film, bodies_path
from .geometry import Box, Plane
from .render import Scene, SyntheticPair
from .room import Film, room, room_film
from .texture import Patch, Texture
from .walkers import WalkersFilm, walkers_film

__all__ = [
    "STATIC_KINDS",
    "BodiesFilm",
    "Box",
    "Film",
    "Patch",
    "Plane",
    "Scene",
    "SyntheticPair",
    "Texture",
    "WalkersFilm",
    "bare_patches",
    "bodies_film",
    "bodies_path",
    "rigid_motion",
    "room",
    "room_film",
    "static_scene",
    "three_blocks",
    "two_blocks",
    "walkers_film",
]
