"""Predefined scenes: blocks in a room, and a camera that looks down on the floor."""

import math

import numpy as np
from numpy.typing import ArrayLike

from tisfm.camera import Camera
from tisfm.checks import Floats, check_finite, check_whole_numbers
from tisfm.errors import InputError
from tisfm.rigid import rigid_motion

from .geometry import Box, Plane
from .render import Scene, SyntheticPair
from .texture import Patch, Texture

# (V, Ω) of the camera in its own axes, length/frame and rad/frame. The rotation adds to the
# sideways flow.
_STATIC_MOTIONS = {
    "sideways": (0.03, 0.0, 0.0, 0.0, 0.0, 0.0),
    "forward": (0.0, 0.0, 0.1, 0.0, 0.0, 0.0),
    "sideways+rotation": (0.03, 0.0, 0.0, 0.002, 0.004, 0.003),
    "forward+rotation": (0.0, 0.0, 0.1, 0.002, 0.004, 0.003),
}
STATIC_KINDS = tuple(_STATIC_MOTIONS)

# The camera looks down on the floor by 25°. The columns are the axes of the room, right, down and
# ahead, in camera axes.
_COS, _SIN = math.cos(math.radians(25)), math.sin(math.radians(25))
_ROOM_AXES = np.array([[1.0, 0.0, 0.0], [0.0, _COS, -_SIN], [0.0, _SIN, _COS]])
_CAMERA_HEIGHT = 2.6  # height of the camera above the floor, in the unit of the scene
_WALL_DISTANCE = 9.0  # distance of the wall from the camera, in the unit of the scene
_MIN_WAVELENGTH = 4.0  # px: shortest wave without octaves of detail, in an image of this width:
_REFERENCE_WIDTH = 320  # px

# A block: position on the floor (right, ahead) and edge lengths, in the unit of the scene; rotation
# about the vertical in degrees.
_Block = tuple[tuple[float, float], tuple[float, float, float], float]
_TWO_BLOCKS: list[_Block] = [
    ((-0.62, 4.7), (1.5, 1.3, 1.2), 28),
    ((0.75, 3.7), (0.8, 0.85, 0.8), -33),
]
_THREE_BLOCKS: list[_Block] = [
    ((-1.0, 4.4), (0.9, 1.2, 0.9), 35),
    ((0.95, 5.6), (1.7, 1.0, 1.0), -18),
    ((0.35, 3.3), (0.55, 0.5, 0.55), 20),
]


def two_blocks(
    height: int = 240,
    width: int = 320,
    *,
    seed: int = 0,
    focal: float | None = None,
    detail: int | None = None,
    camera_motion: ArrayLike = (0.03, 0.0, 0.0, 0.0, 0.0, 0.0),
    block_motions: ArrayLike | None = None,
    samples: int = 3,
    dtype: str = "uint8",
) -> SyntheticPair:
    """Render two blocks that move on their own, each in translation, in front of a moving camera.

    The scene imitates the Marbled-block sequence of the paper's section 6. Both blocks move along
    the floor and to the left, the larger one away from the camera, the smaller one towards it. At
    the default size displacements are about 1 to 4 px. Displacements and shapes scale with the
    size.

    Parameters
    ----------
    height, width : int
        Size of the frames, px.
    seed : int, default 0
        Pattern of the textures.
    focal : float, optional
        Focal length, px; by default the width, so that every size shows the same view.
    detail : int, optional
        Number of fine octaves added to the textures. At the default focal length the shortest wave
        is width/80 px long without fine octaves, and each of them halves this length. By default
        the shortest wave is about 3 to 5 px long if the width is more than about 320 px; smaller
        images have no fine octaves.
    camera_motion : array_like, shape (6,)
        (V, Ω) of the camera in its own axes, length/frame and rad/frame. The blocks are at depths
        of about 4.6 and 4, the background at about 9.
    block_motions : array_like, shape (2, 6), optional
        Twists (T, ω) of the larger and of the smaller block as seen by a camera at rest.
    samples, dtype
        As in `Scene.render`.

    Returns
    -------
    SyntheticPair
        Labels are 0 for the background, 1 for the floor, 2 for the larger block, 3 for the smaller.

    Raises
    ------
    ValueError
        If an option is impossible.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> scene = two_blocks(48, 64)
    >>> scene.frame0.shape, scene.flow.shape, int(scene.labels.max())
    ((48, 64), (48, 64, 2), 3)
    """
    if block_motions is None:
        floor_velocities = _ROOM_AXES @ np.array([[-0.014, 0.0, 0.04], [-0.014, 0.0, -0.04]]).T
        block_motions = np.hstack([floor_velocities.T, np.zeros((2, 3))])
    block_twists = check_finite(block_motions, (2, 6), "block_motions")
    scene = _block_scene(
        _TWO_BLOCKS, block_twists, camera_motion, height, width, seed, focal, detail
    )
    return scene.render(samples=samples, dtype=dtype)


def three_blocks(
    height: int = 240,
    width: int = 320,
    *,
    seed: int = 0,
    focal: float | None = None,
    detail: int | None = None,
    camera_motion: ArrayLike = (0.03, 0.0, 0.0, 0.0, 0.0, 0.0),
    block_motions: ArrayLike | None = None,
    samples: int = 3,
    dtype: str = "uint8",
) -> SyntheticPair:
    """Render three blocks that move on their own, each in translation, in front of a moving camera.

    One block moves away and to the right, one to the left and down. The small block in front comes
    closer.

    Parameters
    ----------
    height, width, seed, focal, detail, camera_motion
        As in `two_blocks`.
    block_motions : array_like, shape (3, 6), optional
        Twists (T, ω) of the blocks as seen by a camera at rest.
    samples, dtype
        As in `Scene.render`.

    Returns
    -------
    SyntheticPair
        Labels are 0 for the background, 1 for the floor, 2 to 4 for the blocks.

    Raises
    ------
    ValueError
        If an option is impossible.

    Examples
    --------
    >>> from tisfm.scenes import three_blocks
    >>> three_blocks(48, 64, seed=1).motions.shape  # wall, floor, three blocks
    (5, 6)
    """
    if block_motions is None:
        block_motions = np.zeros((3, 6))
        block_motions[:, :3] = (0.02, 0.0, 0.03), (-0.03, 0.02, 0.0), (0.01, -0.01, -0.05)
    block_twists = check_finite(block_motions, (3, 6), "block_motions")
    scene = _block_scene(
        _THREE_BLOCKS, block_twists, camera_motion, height, width, seed, focal, detail
    )
    return scene.render(samples=samples, dtype=dtype)


def static_scene(
    kind: str,
    height: int = 240,
    width: int = 320,
    *,
    seed: int = 0,
    focal: float | None = None,
    detail: int | None = None,
    samples: int = 3,
    dtype: str = "uint8",
) -> SyntheticPair:
    """Render three blocks at rest on a floor, seen by a moving camera.

    Parameters
    ----------
    kind : {"sideways", "forward", "sideways+rotation", "forward+rotation"}
        Motion of the camera: V along its X or Z axis, without or with rotation about all three
        axes. At the default size displacements are a few px; they scale with the size.
    height, width, seed, focal, detail
        As in `two_blocks`.
    samples, dtype
        As in `Scene.render`.

    Returns
    -------
    SyntheticPair
        Labels are 0 for the background, 1 for the floor, 2 to 4 for the blocks.

    Raises
    ------
    ValueError
        If the kind is unknown or an option is impossible.

    Examples
    --------
    >>> from tisfm.scenes import STATIC_KINDS, static_scene
    >>> for kind in STATIC_KINDS:
    ...     scene = static_scene(kind, 24, 32)
    >>> bool((scene.motions == scene.motions[0]).all())  # only the camera moves
    True
    """
    if kind not in _STATIC_MOTIONS:
        raise InputError(f"kind is {kind!r}: expected one of {', '.join(map(repr, STATIC_KINDS))}")
    block_twists, motion = np.zeros((3, 6)), _STATIC_MOTIONS[kind]
    scene = _block_scene(_THREE_BLOCKS, block_twists, motion, height, width, seed, focal, detail)
    return scene.render(samples=samples, dtype=dtype)


def bare_patches(
    height: int = 240,
    width: int = 320,
    *,
    seed: int = 0,
    focal: float | None = None,
    camera_motion: ArrayLike = (0.05, 0.015, 0.0, 0.0, 0.0, 0.0),
    samples: int = 3,
    dtype: str = "uint8",
) -> SyntheticPair:
    """Render a block in front of a wall, both with large parts of a single grey level.

    Motion is visible only around such a bare part. The paper of Sekkati and Mitiche leaves this
    case open (its remark (a)). One bare part is surrounded by texture of the wall. A bare part of
    the block reaches the block's right edge, and the wall behind this edge is bare, too: only a
    step of grey separates the two. Shapes scale with the size; at the default size the bare parts
    are 70 to 110 px wide, and displacements are about 2 px on the wall and 4 px on the block.

    Parameters
    ----------
    height, width, seed, focal
        As in `two_blocks`.
    camera_motion : array_like, shape (6,)
        (V, Ω) of the camera in its own axes, length/frame and rad/frame. The block is at a depth
        of about 4.2, the wall at about 8.
    samples, dtype
        As in `Scene.render`.

    Returns
    -------
    SyntheticPair
        Labels are 0 for the wall, 1 for the block; `textured` is False in the bare parts.

    Raises
    ------
    ValueError
        If an option is impossible.

    Examples
    --------
    >>> from tisfm.scenes import bare_patches
    >>> scene = bare_patches(48, 64)
    >>> bool(0.1 < scene.textured.mean() < 0.9)
    True
    """
    check_whole_numbers(1, height=height, width=width)
    motion = -check_finite(camera_motion, (6,), "camera_motion")
    octaves = max(0, round(math.log2(width / _REFERENCE_WIDTH)))

    def make_texture(depth: float, number: int, mean: float, patches: tuple[Patch, ...]) -> Texture:
        return Texture(
            wavelength=_MIN_WAVELENGTH * depth / _REFERENCE_WIDTH,
            detail=octaves,
            mean=mean,
            contrast=50,
            seed=seed + number,
            patches=patches,
        )

    wall_patch = Patch(center=(-2.3, 0.1), size=(2.0, 2.6), grey=105)
    wall_patch_at_edge = Patch(center=(2.1, 0.1), size=(2.4, 2.8), grey=128)
    block_patch = Patch(center=(0.4, 0.0), size=(1.0, 0.9), grey=175)
    block_axes, _ = rigid_motion((0, 0, 0, 0, math.radians(8), 0))
    wall = Plane(
        texture=make_texture(8.0, 0, 110, (wall_patch, wall_patch_at_edge)),
        point=(0, 0, 8),
        normal=(0.1, 0.1, -1),
        motion=motion,
    )
    block = Box(
        texture=make_texture(4.2, 1, 130, (block_patch,)),
        center=(0.05, 0.0, 4.5),
        size=(1.4, 1.6, 0.5),
        axes=block_axes,
        motion=motion,
    )
    camera = Camera(focal=float(width) if focal is None else focal)
    return Scene(objects=[wall, block], camera=camera, height=height, width=width).render(
        samples=samples, dtype=dtype
    )


def _block_scene(
    blocks: list[_Block],
    block_twists: Floats,
    camera_motion: ArrayLike,
    height: int,
    width: int,
    seed: int,
    focal: float | None,
    detail: int | None,
) -> Scene:
    """Return a scene with blocks in front of a wall.

    `block_twists`, (n, 6), are the motions of the blocks as seen by a camera at rest.
    """
    check_whole_numbers(1, height=height, width=width)
    static_twist = -check_finite(camera_motion, (6,), "camera_motion")
    octaves = max(0, round(math.log2(width / _REFERENCE_WIDTH))) if detail is None else detail

    def make_texture(depth: float, label: int, mean: float, contrast: float) -> Texture:
        wavelength, number = _MIN_WAVELENGTH * depth / _REFERENCE_WIDTH, seed + label
        return Texture(
            wavelength=wavelength, detail=octaves, mean=mean, contrast=contrast, seed=number
        )

    def plane(texture: Texture, point: tuple, normal: tuple) -> Plane:
        return Plane(
            texture=texture,
            point=_ROOM_AXES @ point,
            normal=_ROOM_AXES @ normal,
            motion=static_twist,
        )

    objects: list[Plane | Box] = [
        plane(make_texture(_WALL_DISTANCE, 0, 114, 42), (0, 0, _WALL_DISTANCE), (0, 0, -1)),
        plane(make_texture(4.5, 1, 88, 42), (0, _CAMERA_HEIGHT, 0), (0, -1, 0)),
    ]
    for label, ((right, ahead), size, degrees) in enumerate(blocks, start=2):
        center = _ROOM_AXES @ (right, _CAMERA_HEIGHT - size[1] / 2, ahead)
        rotation, _ = rigid_motion((0, 0, 0, 0, math.radians(degrees), 0))
        texture = make_texture(float(center[2]), label, 140, 52)
        motion = static_twist + block_twists[label - 2]
        objects.append(
            Box(
                texture=texture, center=center, size=size, axes=_ROOM_AXES @ rotation, motion=motion
            )
        )
    camera = Camera(focal=float(width) if focal is None else focal)
    return Scene(objects=objects, camera=camera, height=height, width=width)
