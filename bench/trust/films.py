"""Films of the rendered worlds, each with one disturbance, and their truth."""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.trust import worlds
from bench.trust.film_store import name_film, read_film, write_film
from bench.trust.worlds import (
    FRAMES,
    HEIGHT,
    MAKERS,
    OTHER_PLACE,
    WIDTH,
    World,
    with_traffic,
    with_truck,
)
from tisfm import scenes
from tisfm.camera import Camera
from tisfm.rigid import pose_matrix
from tisfm.scenes import Scene
from tisfm.scenes.room import render_rolling_shutter

NOISE = 1.5  # grey levels: noise of every film
SAMPLES = 2  # rays per side of a pixel
LENS_MARGIN = 1.4  # size of the picture that a lens distorts, over the size of the frames
CUT_SHIFT = 40.0  # distance between the two places of a film with a cut

Frames = NDArray[np.float32]  # (N, H, W), grey levels


@dataclass(frozen=True, kw_only=True)
class Disturbance:
    """What differs from the world as it is; `strength` has the unit of the kind.

    Kinds are the names of `CHANGES_OF_WORLD`, `CHANGES_OF_CAMERA` and `CHANGES_OF_PICTURE`.
    """

    kind: str = "clean"
    strength: float = 0.0

    @property
    def name(self) -> str:
        return self.kind if not self.strength else f"{self.kind} {self.strength:g}"


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueFilm:
    """Frames and their truth."""

    frames: NDArray[np.uint8]  # (N, H, W)
    depth: NDArray[np.float32]  # (N, H, W); NaN where the picture shows no single depth
    poses: NDArray[np.float64]  # (N, 4, 4), camera to world
    focal: NDArray[np.float64]  # (N,) px


def render_film(
    name: str,
    disturbance: Disturbance,
    size: tuple[int, int] = (HEIGHT, WIDTH),  # px; smaller frames show the same view
    count: int = FRAMES,
) -> TrueFilm:
    """Return the film of a world; rendered films are stored, see `film_store`."""
    file = name_film(_code_of_rendering(), name, disturbance, size, count)
    stored = read_film(file)
    if stored is not None and stored.keys() == {field.name for field in fields(TrueFilm)}:
        return TrueFilm(**stored)
    film = _render_film(name, disturbance, size, count)
    write_film(file, vars(film))
    return film


@cache
def _code_of_rendering() -> str:
    """Return a digest of the code that decides the films."""
    digest = hashlib.sha256()
    modules = Path(worlds.__file__), Path(__file__)
    files = [*modules, *sorted(Path(scenes.__file__).parent.glob("*.py"))]
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _render_film(
    name: str, disturbance: Disturbance, size: tuple[int, int], count: int
) -> TrueFilm:
    kind, strength = disturbance.kind, disturbance.strength
    random = np.random.default_rng(7)
    if kind == "cut":
        return _joined(name, size, count)
    world = MAKERS[name]()
    world = replace(world, poses=world.poses[:count], focal=world.focal * size[1] / WIDTH)
    if kind in CHANGES_OF_WORLD:
        world = CHANGES_OF_WORLD[kind](world, strength)
    focal = np.full(len(world.poses), world.focal)
    if kind == "zoom":  # strength: growth per frame
        focal = focal * (1 + strength) ** np.arange(len(focal))
    if kind == "lens":  # strength: radial coefficient k1
        frames, depth = _render_distorted(world, size, strength)
    else:
        readout = strength if kind == "shutter" else 0.0  # strength: readout time, frame intervals
        frames, depth = _render(world, size, focal, readout)
    if kind in CHANGES_OF_PICTURE:
        frames, depth = CHANGES_OF_PICTURE[kind](frames, depth, strength, random)
    frames = frames + np.float32(NOISE) * random.standard_normal(frames.shape, np.float32)
    return TrueFilm(
        frames=np.clip(np.rint(frames), 0, 255).astype(np.uint8),
        depth=depth,
        poses=world.poses,
        focal=focal,
    )


def _render(
    world: World, size: tuple[int, int], focal: NDArray, readout: float = 0.0
) -> tuple[Frames, NDArray[np.float32]]:
    """Return the frames, and their depth."""
    frames = np.empty((len(focal), *size), np.float32)
    depth = np.empty((len(focal), *size), np.float32)
    for k, pose in enumerate(world.poses):

        def scene_at(delay: float, k: int = k) -> Scene:
            return _scene(world, size, focal[k], k + delay)

        depth[k], labels = scene_at(0.0).depth_and_labels(pose)
        if readout:
            frames[k] = render_rolling_shutter(scene_at, world.poses, k, readout, SAMPLES)
        else:
            frames[k] = scene_at(0.0).render_frame(pose, samples=SAMPLES)
        if world.mirror is not None:
            is_mirror = labels == labels.max()  # the mirror is the last of the surfaces
            frames[k][is_mirror] = _reflection(world, size, focal[k], pose)[is_mirror]
            depth[k][is_mirror] = np.nan
    return frames, depth


def _scene(world: World, size: tuple[int, int], focal: float, time: float) -> Scene:
    height, width = size
    return Scene(
        objects=world.surfaces_at(time), camera=Camera(focal=focal), height=height, width=width
    )


def _reflection(
    world: World, size: tuple[int, int], focal: float, pose: NDArray
) -> NDArray[np.float32]:
    """Return the picture that the mirror shows: the room from behind the mirror, flipped."""
    mirror = world.mirror
    assert mirror is not None
    normal = np.asarray(mirror.normal)
    reflect = np.eye(3) - 2 * np.outer(normal, normal)
    behind = np.eye(4)
    behind[:3, :3] = reflect @ pose[:3, :3] @ np.diag([-1.0, 1.0, 1.0])
    distance = (pose[:3, 3] - mirror.point) @ normal
    behind[:3, 3] = pose[:3, 3] - 2 * distance * normal
    visible = [item for item in world.surfaces if all(item is not other for other in mirror.hidden)]
    height, width = size
    scene = Scene(objects=visible, camera=Camera(focal=focal), height=height, width=width)
    return np.asarray(scene.render_frame(behind, samples=SAMPLES)[:, ::-1])


def _render_distorted(
    world: World, size: tuple[int, int], radial: float
) -> tuple[Frames, NDArray[np.float32]]:
    """Return frames, and depth, as a lens with the coefficient k1 shows them."""
    large = 2 * round(size[0] * LENS_MARGIN / 2), 2 * round(size[1] * LENS_MARGIN / 2)
    frames, depth = _render(world, large, np.full(len(world.poses), world.focal))
    rows, columns = np.mgrid[: size[0], : size[1]]
    x, y = (
        (index - (side - 1) / 2) / world.focal
        for index, side in zip((columns, rows), size[::-1], strict=True)
    )
    distorted = np.hypot(x, y)
    straight = distorted.copy()
    for _ in range(30):  # Newton's method for r_d = r (1 + k1 r²)
        slope = 1 + 3 * radial * straight**2
        straight -= (straight * (1 + radial * straight**2) - distorted) / slope
    if not (slope > 0).all() or straight.max() > LENS_MARGIN * distorted.max():
        raise ValueError(f"k1 is {radial}: expected a lens that shows the whole frame")
    ratio = np.where(distorted > 0, straight / np.maximum(distorted, 1e-12), 1.0)
    map_x, map_y = (
        (world.focal * ratio * value + (side - 1) / 2).astype(np.float32)
        for value, side in zip((x, y), large[::-1], strict=True)
    )
    bent = [cv2.remap(f, map_x, map_y, cv2.INTER_CUBIC) for f in frames]
    return np.array(bent), np.array([cv2.remap(d, map_x, map_y, cv2.INTER_NEAREST) for d in depth])


def _joined(name: str, size: tuple[int, int], count: int) -> TrueFilm:
    """Return a film that cuts to another place, with other textures, after its first half."""
    kind, seed = name.rsplit(" ", 1)
    first, second = (
        render_film(each, Disturbance(), size, count)
        for each in (name, f"{kind} {int(seed) + OTHER_PLACE}")
    )
    half = count // 2
    shift = pose_matrix((CUT_SHIFT, 0, 0, 0, math.pi / 2, 0))
    return TrueFilm(
        frames=np.concatenate([first.frames[:half], second.frames[half:]]),
        depth=np.concatenate([first.depth[:half], second.depth[half:]]),
        poses=np.concatenate([first.poses[:half], shift @ second.poses[half:]]),
        focal=np.concatenate([first.focal[:half], second.focal[half:]]),
    )


# Changes of the world: (world, strength) → world.


def _only_turn(world: World, turn: float) -> World:
    """Keep the position of the camera; `turn` is in rad/frame."""
    poses = np.array(
        [
            world.poses[0] @ pose_matrix((0, 0, 0, 0.2 * turn * math.sin(0.5 * k), turn * k, 0))
            for k in range(len(world.poses))
        ]
    )
    return replace(world, poses=poses)


def _roll(world: World, turn: float) -> World:
    """Turn the camera about its axis; `turn` is in rad/frame."""
    rolls = [pose_matrix((0, 0, 0, 0, 0, turn * k)) for k in range(len(world.poses))]
    return replace(world, poses=np.array([p @ r for p, r in zip(world.poses, rolls, strict=True)]))


def _move_less(world: World, share: float) -> World:
    """Shrink the path to a share of its length; the turns stay."""
    poses = world.poses.copy()
    poses[:, :3, 3] *= share
    return replace(world, poses=poses)


def _shake(world: World, _: float) -> World:
    """Turn the camera unevenly, so that a rolling shutter shows."""
    turns = [
        pose_matrix((0, 0, 0, 0.02 * math.sin(1.1 * k), 0.03 * math.sin(0.8 * k), 0))
        for k in range(len(world.poses))
    ]
    return replace(world, poses=np.array([p @ t for p, t in zip(world.poses, turns, strict=True)]))


CHANGES_OF_WORLD: dict[str, Callable[[World, float], World]] = {
    "pan": _only_turn,
    "roll": _roll,
    "low parallax": _move_less,
    "shutter": _shake,
    "traffic": lambda world, count: with_traffic(world, int(count)),
    "truck": with_truck,
}

CHANGES_OF_CAMERA = ("zoom", "lens", "shutter")


# Changes of the picture: (frames, depth, strength, random) → frames and depth. What covers the
# scene has no depth.

Changed = tuple[Frames, NDArray[np.float32]]
Random = np.random.Generator


def _grain(shape: tuple[int, ...], random: Random, wave: float) -> Frames:
    """Return a random pattern with the deviation 1; `wave` is the deviation of its blur, px."""
    grain = random.standard_normal(shape[-2:], np.float32)
    blurred = cv2.GaussianBlur(grain, (0, 0), wave) if wave else grain
    return np.asarray(blurred / blurred.std())


def _cover(frames: Frames, depth: NDArray, mask: NDArray, picture: NDArray) -> Changed:
    return np.where(mask, picture, frames), np.where(mask, np.float32(np.nan), depth)


def _overlay(frames: Frames, depth: NDArray, share: float, random: Random) -> Changed:
    """Cover the lowest part of the picture by a textured band; `share` of the height."""
    rows = np.arange(frames.shape[1])[:, None]
    mask = np.broadcast_to(rows >= frames.shape[1] * (1 - share), frames.shape[1:])
    return _cover(frames, depth, mask, 120 + 45 * _grain(frames.shape, random, 2.0))


def _bonnet(frames: Frames, depth: NDArray, share: float, random: Random) -> Changed:
    """Cover the lower part by a bonnet with a round edge; `share` of the height in the middle."""
    height, width = frames.shape[1:]
    rows, columns = np.mgrid[:height, :width]
    edge = height * (1 - share * (1 - 0.8 * ((columns - width / 2) / (width / 2)) ** 2))
    shine = 60 + 50 * np.exp(-(((rows - edge) / 8) ** 2)) + 8 * _grain(frames.shape, random, 3.0)
    return _cover(frames, depth, rows >= edge, shine)


def _logo(frames: Frames, depth: NDArray, share: float, random: Random) -> Changed:
    """Cover a corner by a logo; `share` of the width."""
    height, width = frames.shape[1:]
    side = round(share * width)
    mask, text = np.zeros((height, width), bool), np.full((height, width), 235, np.uint8)
    mask[6 : 6 + side // 2, width - side - 6 : width - 6] = True
    place = (width - side - 2, 2 + side // 2)
    cv2.putText(text, "LIVE", place, cv2.FONT_HERSHEY_DUPLEX, side / 90, 20, 2)
    return _cover(frames, depth, mask, text.astype(np.float32))


def _caption(frames: Frames, depth: NDArray, _: float, random: Random) -> Changed:
    """Write two lines of text over the lower part."""
    height, width = frames.shape[1:]
    text = np.zeros((height, width), np.uint8)
    for line, words in enumerate(("and so the camera turned", "towards the end of the hall")):
        place = (round(0.12 * width), round((0.82 + 0.1 * line) * height))
        cv2.putText(text, words, place, cv2.FONT_HERSHEY_DUPLEX, width / 550, 255, 1)
    return _cover(frames, depth, text > 128, np.full(text.shape, 250, np.float32))


def _letterbox(frames: Frames, depth: NDArray, share: float, random: Random) -> Changed:
    """Cover the highest and the lowest part by black bars; `share` of the height each."""
    rows = np.arange(frames.shape[1])[:, None] / frames.shape[1]
    mask = np.broadcast_to((rows < share) | (rows >= 1 - share), frames.shape[1:])
    return _cover(frames, depth, mask, np.full(frames.shape[1:], 8, np.float32))


def _bands(frames: Frames, depth: NDArray, amount: float, random: Random) -> Changed:
    """Multiply rows by bands of light that move from frame to frame."""
    rows = np.arange(frames.shape[1])[:, None] / frames.shape[1] * 13.3
    numbers = np.arange(len(frames))[:, None, None]
    return (frames * (1 + amount * np.sin(rows + 2.1 * numbers))).astype(np.float32), depth


def _vignette(frames: Frames, depth: NDArray, amount: float, random: Random) -> Changed:
    """Darken the corners by a share."""
    height, width = frames.shape[1:]
    rows, columns = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    return (frames * (1 - amount * (rows**2 + columns**2) / 2)).astype(np.float32), depth


def _exposure(frames: Frames, depth: NDArray, amount: float, random: Random) -> Changed:
    """Change the gain smoothly by up to a share, as an automatic exposure does."""
    gain = 1 + amount * np.sin(0.45 * np.arange(len(frames)) - 1)
    return (frames * gain[:, None, None]).astype(np.float32), depth


def _flicker(frames: Frames, depth: NDArray, amount: float, random: Random) -> Changed:
    """Change the gain at random from frame to frame by a share."""
    gain = 1 + amount * random.uniform(-1, 1, len(frames))
    return (frames * gain[:, None, None]).astype(np.float32), depth


def _brighter(frames: Frames, depth: NDArray, amount: float, random: Random) -> Changed:
    """Make one frame brighter, grey levels."""
    frames = frames.copy()
    frames[min(5, len(frames) - 1)] += amount
    return frames, depth


def _white_noise(frames: Frames, depth: NDArray, amount: float, random: Random) -> Changed:
    """Add noise that differs from frame to frame, grey levels."""
    return frames + np.float32(amount) * random.standard_normal(frames.shape, np.float32), depth


def _fixed_noise(frames: Frames, depth: NDArray, amount: float, random: Random) -> Changed:
    """Add one pattern of noise to all frames, grey levels."""
    return frames + np.float32(amount) * _grain(frames.shape, random, 0.0), depth


CHANGES_OF_PICTURE: dict[str, Callable[[Frames, NDArray, float, Random], Changed]] = {
    "overlay": _overlay,
    "bonnet": _bonnet,
    "logo": _logo,
    "caption": _caption,
    "letterbox": _letterbox,
    "bands": _bands,
    "vignette": _vignette,
    "exposure": _exposure,
    "flicker": _flicker,
    "brighter frame": _brighter,
    "noise": _white_noise,
    "fixed noise": _fixed_noise,
}
