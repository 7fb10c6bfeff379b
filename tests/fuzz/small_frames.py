"""Small random frames as no camera takes them, and frames that follow them."""

import cv2
import numpy as np

LEAST, MOST = 4, 130  # px: sides; frames of one kind of shape are longer

# What a frame shows: grey levels, (H, W) float32 in [0, 255].


def constant(rng, height, width):
    return np.full((height, width), rng.integers(0, 256), np.float32)


def step(rng, height, width):
    """Two halves, along a line of any direction."""
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    angle, low = rng.uniform(0, 2 * np.pi), rng.uniform(0, 255)
    beyond = (columns - rng.uniform(0, width)) * np.cos(angle) + (
        rows - rng.uniform(0, height)
    ) * np.sin(angle)
    return np.where(beyond > 0, np.float32(rng.uniform(low, 255)), np.float32(low))


def patches(rng, height, width):
    """Rectangles over one another, some of them textured."""
    frame = constant(rng, height, width)
    for _ in range(rng.integers(1, 9)):
        top, left = rng.integers(height), rng.integers(width)
        rows, columns = 1 + rng.integers(height), 1 + rng.integers(width)
        part = frame[top : top + rows, left : left + columns]
        part[...] = rng.uniform(0, 255)
        if rng.random() < 0.5:
            part += rng.uniform(-60, 60, part.shape).astype(np.float32)
    return frame.clip(0, 255)


def periodic(rng, height, width):
    """Waves or a chessboard, down to two pixels a period."""
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    if rng.random() < 0.5:
        side = rng.integers(1, 9)
        return (rows // side + columns // side) % 2 * np.float32(rng.uniform(1, 255))
    angle, period = rng.uniform(0, 2 * np.pi), np.exp(rng.uniform(np.log(2), np.log(40)))
    phase = (columns * np.cos(angle) + rows * np.sin(angle)) * (2 * np.pi / period)
    frame = 127.5 + rng.uniform(1, 127) * np.sin(phase)
    if rng.random() < 0.3:  # as in the other direction
        frame = (frame + frame[::-1]) / 2
    return frame.astype(np.float32)


def dark(rng, height, width):
    """Little above black, with a spot or two."""
    frame = rng.poisson(rng.uniform(0.01, 3), (height, width)).astype(np.float32)
    for _ in range(rng.integers(0, 3)):
        frame[rng.integers(height), rng.integers(width)] = rng.uniform(0, 255)
    return frame


def saturated(rng, height, width):
    """A texture of which much is white, black or both."""
    frame = 127.5 + rng.uniform(2, 20) * (texture(rng, height, width) - rng.uniform(60, 200))
    return frame.clip(0, 255).astype(np.float32)


def salt_and_pepper(rng, height, width):
    """A bare or textured frame with black and white pixels."""
    frame = (constant if rng.random() < 0.5 else texture)(rng, height, width)
    share, value = rng.uniform(0.001, 0.5), rng.random((height, width))
    frame[value < share / 2], frame[value > 1 - share / 2] = 0, 255
    return frame


def noise(rng, height, width):
    """Noise, every pixel for itself."""
    return rng.uniform(0, rng.uniform(1, 255), (height, width)).astype(np.float32)


def ramp(rng, height, width):
    """A slope, which shows no motion along its levels."""
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    frame = rng.normal() * columns / width + rng.normal() * rows / height
    if rng.random() < 0.3:
        frame *= frame
    return (127.5 + rng.uniform(1, 120) * frame).clip(0, 255).astype(np.float32)


def spots(rng, height, width):
    """A bare frame with a few pixels that differ."""
    frame = constant(rng, height, width)
    for _ in range(rng.integers(1, 6)):
        frame[rng.integers(height), rng.integers(width)] = rng.uniform(0, 255)
    return frame


def texture(rng, height, width):
    """Smooth noise: the one kind that real frames resemble."""
    frame = rng.uniform(0, 1, (height, width)).astype(np.float32)
    frame = cv2.GaussianBlur(frame, (0, 0), rng.uniform(0.7, 4))
    return cv2.normalize(frame, None, 0, rng.uniform(20, 255), cv2.NORM_MINMAX)


KINDS = {
    kind.__name__: kind
    for kind in (
        constant, step, patches, periodic, dark, saturated, salt_and_pepper, noise, ramp, spots,
        texture,
    )
}  # fmt: skip

# The frame after another one.


def same(rng, frame, kind):
    return frame.copy()


def shifted(rng, frame, kind):
    """Moved by whole pixels, what leaves it coming back on the other side."""
    reach = max(1, max(frame.shape) // 10)
    return np.roll(frame, tuple(rng.integers(-reach, reach + 1, 2)), (0, 1))


def warped(rng, frame, kind):
    """Moved, turned and enlarged a little."""
    height, width = frame.shape
    middle = (width - 1) / 2, (height - 1) / 2
    matrix = cv2.getRotationMatrix2D(middle, rng.normal(0, 3), np.exp(rng.normal(0, 0.05)))
    matrix[:, 2] += rng.normal(0, 2, 2)
    return cv2.warpAffine(frame, matrix, (width, height), borderMode=cv2.BORDER_REFLECT)


def parted(rng, frame, kind):
    """Moved, but for a rectangle that moves otherwise."""
    after, own = shifted(rng, frame, kind), shifted(rng, frame, kind)
    height, width = frame.shape
    top, left = rng.integers(height), rng.integers(width)
    place = np.s_[top : top + 1 + height // 3, left : left + 1 + width // 3]
    after[place] = own[place]
    return after


def noisy(rng, frame, kind):
    """The same with noise."""
    changed = frame + rng.normal(0, np.exp(rng.uniform(-2, 3)), frame.shape)
    return changed.clip(0, 255).astype(np.float32)


def lit(rng, frame, kind):
    """The same, brighter or darker."""
    return (frame * rng.uniform(0.3, 2) + rng.uniform(-30, 30)).clip(0, 255).astype(np.float32)


def cut(rng, frame, kind):
    """Another frame of the kind."""
    return KINDS[kind](rng, *frame.shape)


def cut_to_another(rng, frame, kind):
    """A frame of any kind."""
    return KINDS[rng.choice(list(KINDS))](rng, *frame.shape)


FOLLOWING = {
    way.__name__: way
    for way in (same, shifted, warped, parted, noisy, lit, cut, cut_to_another)
}  # fmt: skip

# Frames of one scene, of which other parts move by other amounts: depth and things are found there.


def layers(rng, height, width, count):
    """Rectangles before a slanted ground, past which the camera moves; some move on their own."""
    margin = 2 * max(height, width)
    ground = sum(
        cv2.resize(
            noise(rng, *side), (width + margin, height + margin), interpolation=cv2.INTER_CUBIC
        )
        for side in ((5, 7), (17, 23), (height + margin, width + margin))
    )
    ground = cv2.normalize(ground, None, 0, 255, cv2.NORM_MINMAX)
    step = rng.normal(0, rng.choice((0.3, 1, 3)), 2)
    slant = rng.normal(0, 2 / height)
    things = [_thing(rng, height, width) for _ in range(rng.integers(0, 4))]
    found = []
    for k in range(count):
        moved = k * step
        matrix = np.array([[1.0, moved[0] * slant, moved[0]], [0, 1 + moved[1] * slant, moved[1]]])
        matrix[:, 2] -= margin / 2
        frame = cv2.warpAffine(ground, matrix, (width, height), borderMode=cv2.BORDER_REFLECT)
        for content, place, nearness, own in things:
            matrix[:] = np.eye(2, 3)
            matrix[:, 2] = place + k * (nearness * step + own)
            seen = cv2.warpAffine(np.ones_like(content), matrix, (width, height))
            frame += seen * (cv2.warpAffine(content, matrix, (width, height)) - frame)
        found.append(frame)
    return found


def _thing(rng, height, width):
    """Return what a rectangle shows, its place, how near it is, and its own motion, px/frame."""
    sides = np.maximum(2, rng.uniform(0.15, 0.6, 2) * (height, width)).astype(int)
    content = KINDS[rng.choice(("texture", "texture", "noise", "patches", "constant"))](rng, *sides)
    own = rng.normal(0, 2, 2) * (rng.random() < 0.7)
    return content, rng.uniform(0, (width, height)) - sides[::-1] / 2, rng.uniform(1, 3), own


# The type that frames are given as: grey or RGB.
# "unit" is float32 in [0, 1], "far" on a scale of its own.
TYPES = ("uint8", "uint8", "uint16", "float32", "float64", "unit", "far")


def converted(frame, kind, colour):
    """Return a frame of a type, (H, W), or (H, W, 3) with a weight for each of its colours."""
    if colour is not None:
        frame = frame[..., None] * np.asarray(colour, np.float32)
    if kind == "uint8":
        return np.rint(frame).astype(np.uint8)
    if kind == "uint16":
        return np.rint(frame * 257).astype(np.uint16)
    if kind == "unit":
        return (frame / np.float32(255)).astype(np.float32)
    if kind == "far":
        return (frame.astype(np.float64) - 100) * 3e4
    return frame.astype(kind)


# The shape.


def smallest(rng):
    return tuple(int(side) for side in rng.integers(LEAST, LEAST + 5, 2))


def usual(rng):
    return tuple(int(side) for side in np.exp(rng.uniform(np.log(LEAST), np.log(MOST), 2)))


def long(rng):
    sides = [int(rng.integers(LEAST, 24)), int(rng.integers(100, 420))]
    rng.shuffle(sides)
    return tuple(sides)


def wide(rng):
    """As panoramas are: `objects` took longest for frames of this shape."""
    return int(rng.integers(60, 110)), int(rng.integers(200, 310))


def square(rng):
    side = int(rng.integers(LEAST, MOST))
    return side, side


def film(rng):
    """As large as paths of the camera need."""
    return tuple(int(side) for side in rng.integers(48, 150, 2))


SHAPES = {shape.__name__: shape for shape in (smallest, usual, long, wide, square, film)}


def frames(rng, shape, kind, following):
    """Return frames that follow one another, (H, W) float32 in [0, 255].

    Parameters
    ----------
    rng : numpy.random.Generator
    shape : (int, int)
    kind : str
        Of `KINDS`: what the first shows.
    following : sequence of str
        Of `FOLLOWING`: how each comes from the one before.
    """
    found = [KINDS[kind](rng, *shape)]
    for way in following:
        found.append(FOLLOWING[way](rng, found[-1], kind))
    return [np.float32(frame).clip(0, 255) for frame in found]
