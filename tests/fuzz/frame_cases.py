"""One random case of frames given to an entry point of the library, told by its number."""

import traceback
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import tisfm
from tests.fuzz import promises, small_frames
from tisfm import runtime
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.rigid import pose_matrix
from tisfm.scenes import bodies_film, bodies_path, room_film

PRESETS = ("fast", "balanced", "accurate")
WAYS = (
    ("interpret", "field"), ("interpret", "camera"), ("interpret", "objects"),
    ("sequence", "field"), ("sequence", "camera"), ("sequence", "objects"),
    ("reconstruct", "camera"), ("reconstruct", "objects"), ("stream", "camera"),
)  # fmt: skip
CAMERAS = (
    "guessed", "guessed", "pinhole", "pinhole", "off_centre", "lens", "oblong", "rolling", "absurd",
)  # fmt: skip
GIVEN = ("nothing", "mask", "pose", "labels", "mask_and_pose")
SCENES = (
    "room",
    "layers",
    "bodies",
)  # kinds that move as a scene does, of which some frames are spoilt
# What a call may raise of frames that are valid, as its docstring says.
REFUSALS = ("distortion leaves data at", "mask is black at all pixels")


@dataclass(frozen=True, kw_only=True)
class Case:
    """What is called, and how.

    Attributes
    ----------
    entry, motion, preset : str
    kind : str
        What the first frame shows; or one of `SCENES`.
    following : tuple of str
        How each other frame comes from the one before.
    shape : (int, int)
    type : str
        Of the arrays.
    colour : tuple of 3 floats, or None
    camera : str
        Of `CAMERAS`.
    given : str
        Of `GIVEN`, as far as the entry takes it.
    options : dict
        Of the entry.
    view : dict
        Which part of the frames is taken, and at what size: ``crop`` and ``size``.
    changes : dict
        Of the settings.
    seed : tuple of int
        Of what the frames show, and of the numbers that are given.
    """

    entry: str
    motion: str
    preset: str
    kind: str
    following: tuple[str, ...]
    shape: tuple[int, int]
    type: str
    colour: tuple[float, ...] | None
    camera: str
    given: str
    options: dict = field(default_factory=dict)
    view: dict = field(default_factory=dict)
    changes: dict = field(default_factory=dict)
    seed: tuple[int, ...]

    def settings(self):
        return tisfm.Settings.preset(self.preset, motion=self.motion, **self.changes)


def drawn(seed, number, *, way=None, preset=None, kind=None, shape=None):
    """Return the case of a number, with choices that are fixed instead of drawn."""
    rng = np.random.default_rng([seed, number])
    chance = rng.random(8)
    entry, motion = way or WAYS[rng.integers(len(WAYS))]
    preset = preset or str(rng.choice(PRESETS))
    kinds = list(small_frames.KINDS)
    is_pair, is_film = entry == "interpret", entry in ("reconstruct", "stream")
    if kind is None:
        kind = str(rng.choice(SCENES if chance[0] < (0.7 if is_film else 0.5) else kinds))
    count = 1 if is_pair else int(rng.integers(1, 8 if is_film else 4))
    if kind in SCENES and is_film:
        count += 4
    following = [str(rng.choice(list(small_frames.FOLLOWING))) for _ in range(count)]
    if chance[1] < 0.5:  # one kind of motion throughout
        following = [following[0]] * count
    odds = (0.05, 0.1, 0.1, 0.15, 0.1, 0.5) if kind in SCENES else (0.2, 0.4, 0.15, 0.1, 0.15, 0)
    how = shape or str(rng.choice(list(small_frames.SHAPES), p=odds))
    height, width = small_frames.SHAPES[how](rng)
    colour = None
    if chance[2] < 0.3:
        colour = tuple(np.round(rng.uniform(0.2, 1, 3), 3).tolist())
    return Case(
        entry=entry,
        motion=motion,
        preset=preset,
        kind=kind,
        following=tuple(following),
        shape=(height, width),
        type=str(rng.choice(small_frames.TYPES)),
        colour=colour,
        camera=str(rng.choice(CAMERAS)),
        given=str(rng.choice(GIVEN)) if chance[3] < 0.5 else "nothing",
        options=_options(rng, entry, motion),
        view={} if is_pair or chance[5] < 0.8 else _view(rng, height, width),
        changes=_changes(rng) if chance[4] < 0.25 else {},
        seed=(seed, number),
    )


def _options(rng, entry, motion):
    """Return options of an entry."""
    if entry == "sequence":
        window = 3 if motion == "field" and rng.random() < 0.5 else 2
        return {"window": window}
    if entry == "stream":
        return {"delay": int(rng.integers(6, 9)), "calibrate": _one(rng, None, "nothing", "focal")}
    if entry == "reconstruct":
        return {
            "depth_of": _one(rng, "all", "all", "keyframes", "none"),
            "calibrate": _one(rng, None, "nothing", "focal", "radial"),
        }
    return {}


def _view(rng, height, width):
    """Return a part of frames, and a size that leaves 4 px of its shorter side."""
    columns, rows = (int(rng.integers(4, side + 1)) for side in (width, height))
    left, top = int(rng.integers(width - columns + 1)), int(rng.integers(height - rows + 1))
    longer, shorter = max(rows, columns), min(rows, columns)
    least = int(np.ceil(4 * longer / shorter))
    return {"crop": (left, top, columns, rows), "size": int(rng.integers(least, longer + 3))}


def shape_of(case):
    """Return the shape of the frames as they are taken."""
    if not case.view:
        return case.shape
    *_, columns, rows = case.view["crop"]
    scale = min(1.0, case.view["size"] / max(rows, columns))
    return round(rows * scale), round(columns * scale)


def _changes(rng):
    """Return settings other than the preset's."""
    choices = {
        "align_scales": True,
        "model": "translation",
        "max_objects": int(rng.integers(1, 4)),
        "solver": "cholesky",
        "finest_level": 1,
        "derivatives": "cube",
        "normalization": None,
        "data_contrast": None,
        "pyramid_levels": 1,
        "presmoothing": 0.0,
        "cycles": 1,
    }
    names = rng.choice(list(choices), rng.integers(1, 4), replace=False)
    return {str(name): choices[name] for name in names}


def _one(rng, *choices):
    return choices[rng.integers(len(choices))]


def frames_of(case):
    """Return the frames of a case as they are given."""
    rng = np.random.default_rng([*case.seed, 1])
    if case.kind in SCENES:
        found = _scene(rng, case)
    else:
        found = small_frames.frames(rng, case.shape, case.kind, case.following)
    return [small_frames.converted(frame, case.type, case.colour) for frame in found]


def _scene(rng, case):
    """Return frames of a scene, some of which are others: those follow the frames before them."""
    count, camera = len(case.following) + 1, camera_of(case)
    focal = 1.2 * max(case.shape) if camera is None else camera.focal
    options = {"samples": 1, "focal": focal, "seed": int(rng.integers(100))}
    if case.kind == "layers":
        found = small_frames.layers(rng, *case.shape, count)
    elif case.kind == "bodies":
        bodies = int(rng.integers(1, 4))
        film = bodies_film(bodies_path(count), *case.shape, bodies=bodies, **options)
        found = [np.float32(frame) for frame in film.frames]
    else:
        step = pose_matrix([*rng.normal(0, 0.1, 3), *rng.normal(0, 0.01, 3)])
        poses = [np.linalg.matrix_power(step, k) for k in range(count)]
        film = room_film(poses, *case.shape, **options)
        found = [np.float32(frame) for frame in film.frames]
    spoilt = rng.choice((0, 0.1, 0.3))
    for k, way in enumerate(case.following):
        if rng.random() < spoilt:
            found[k + 1] = small_frames.FOLLOWING[way](rng, found[k], "noise")
    return [np.float32(frame).clip(0, 255) for frame in found]


def camera_of(case):
    """Return the camera of a case."""
    rng = np.random.default_rng([*case.seed, 2])
    height, width = case.shape
    side = max(height, width)
    focal = side * np.exp(rng.uniform(np.log(0.4), np.log(4)))
    if case.camera == "guessed":
        return None
    if case.camera == "off_centre":
        return tisfm.Camera(focal, (rng.uniform(0, width), rng.uniform(0, height)))
    if case.camera == "absurd":
        focal = max(1e-3, side * 10.0 ** rng.uniform(-4, 3))
        center = (width, height) * rng.normal(0.5, 10.0 ** rng.uniform(-1, 3), 2)
        return tisfm.Camera(focal, center if rng.random() < 0.5 else None)
    if case.camera == "lens":
        return tisfm.Camera(focal, distortion=rng.normal(0, (0.1, 0.02, 0.002, 0.002)))
    if case.camera == "oblong":
        return tisfm.Camera(focal, aspect=np.exp(rng.normal(0, 0.2)))
    if case.camera == "rolling":
        return tisfm.Camera(focal, readout=rng.uniform(-1, 1))
    return tisfm.Camera(focal)


def pose_of(case, rng):
    """Return a known motion: a 4×4 or 3×3 matrix."""
    pose = pose_matrix([*rng.normal(0, 1, 3), *rng.normal(0, 0.03, 3)])
    pose[:3, 3] *= _one(rng, 0, 1, 1, 1, 1e-3, 1e3, 1e-29, 1e29)
    return pose if rng.random() < 0.6 else pose[:3, :3]


def mask_of(case, rng):
    """Return a mask of any share of the pixels, with one white pixel at least."""
    height, width = case.shape
    mask = rng.random((height, width)) < rng.random()
    if rng.random() < 0.7:  # a part of the frame
        mask = np.ones((height, width), bool)
        top, left = rng.integers(height), rng.integers(width)
        mask[top : top + height // 2 + 1, left : left + width // 2 + 1] = False
        if rng.random() < 0.3:
            mask = ~mask
    mask[rng.integers(height), rng.integers(width)] = True
    return mask


def run(case):
    """Run a case, with warnings as errors; `AssertionError` if a promise is broken.

    Returns
    -------
    str
        ``"result"``, or ``"refused"`` where the docstring names the error.
    """
    runtime.start()  # Taichi itself warns
    images = frames_of(case)
    before = [image.copy() for image in images]
    with warnings.catch_warnings(), TemporaryDirectory(prefix="tisfm-fuzz-") as folder:
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", GuessedFocalWarning)
        try:
            _CALLS[case.entry](case, images, Path(folder))
        except ValueError as error:
            if not any(text in str(error) for text in REFUSALS):
                raise
            return "refused"
    for image, given in zip(images, before, strict=True):
        promises.check_same(image, given, "a frame was modified: it")
    return "result"


def outcome(case):
    """Return what `run` returns, or what is wrong, with where it was raised."""
    try:
        return run(case)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)
        own = [f for f in place if "/tisfm/" in f.filename or "/tests/" in f.filename][-1]
        where = f"{Path(own.filename).name}:{own.lineno}"
        return f"wrong: {type(error).__name__} at {where}: {' '.join(str(error).split())[:300]}"


def _interpret(case, images, folder):
    rng = np.random.default_rng([*case.seed, 3])
    pose = pose_of(case, rng) if "pose" in case.given and case.motion == "camera" else None
    mask = None
    if "mask" in case.given:
        mask = mask_of(case, rng)
        if rng.random() < 0.5:
            mask = np.stack([mask, mask_of(case, rng)])
    options = dict(camera=camera_of(case), settings=case.settings(), pose=pose, mask=mask)
    result = tisfm.interpret(*images, **options)
    promises.check_interpretation(result, case.shape, case.settings(), pose=pose)
    promises.check_saved(result, folder / "result.npz")
    if pose is None and case.camera != "rolling" and mask is None:
        promises.check_same_frames(*images, result)
    if rng.random() < 0.1:
        again = tisfm.interpret(*images, **options)
        for name in ("rho", "inverse_depth", "confidence", "occlusion", "status"):
            promises.check_same(getattr(again, name), getattr(result, name), f"{name}, once more,")


def _sequence(case, images, folder):
    rng = np.random.default_rng([*case.seed, 3])
    poses = mask = None
    if "pose" in case.given and case.motion == "camera":
        poses = [pose_of(case, rng) for _ in images[1:]]
    if "mask" in case.given:
        mask = np.stack([mask_of(case, rng) for _ in images])
    found = list(
        tisfm.interpret_sequence(
            images,
            camera=camera_of(case),
            settings=case.settings(),
            poses=poses,
            mask=mask,
            **case.options,
            **case.view,
        )
    )
    promises.promise(len(found) == len(images) - 1, f"there are {len(found)} pairs")
    for number, result in enumerate(found):
        pose = None if poses is None else poses[number]
        promises.check_interpretation(result, shape_of(case), case.settings(), pose=pose)
        promises.check_saved(result, folder / "result.npz")


def _reconstruct(case, images, folder):
    rng = np.random.default_rng([*case.seed, 3])
    options, camera = dict(case.options), camera_of(case)
    poses = mask = labels = sizes = None
    if "pose" in case.given:
        poses = _path(case, rng, len(images))
        options["calibrate"] = None
        if options["depth_of"] == "none":
            options["depth_of"] = "all"
    if "mask" in case.given:
        mask = np.stack([mask_of(case, rng) for _ in images])
    if case.given == "labels" and case.motion == "objects":
        labels = np.stack([_labels(case, rng) for _ in images])
        if not case.view:  # of which things are left
            sizes = {int(n): rng.uniform(0.1, 2) for n in np.unique(labels) if 0 < n < 255}
    if camera is not None and camera.distortion and options["calibrate"] == "radial":
        options["calibrate"] = "focal"
    result = tisfm.reconstruct(
        images,
        camera=camera,
        settings=case.settings(),
        poses=poses,
        mask=mask,
        labels=labels,
        object_sizes=sizes,
        folder=folder / "result" if rng.random() < 0.7 else None,
        **options,
        **case.view,
    )
    promises.check_reconstruction(
        result,
        len(images),
        shape_of(case),
        settings=case.settings(),
        depth_of=options["depth_of"],
        poses=poses,
    )
    promises.check_copied(result, folder / "copy")
    if rng.random() < 0.5:
        promises.check_fused(result)


def _path(case, rng, count):
    """Return poses of so many frames, some of them not known."""
    step = pose_matrix([*rng.normal(0, 0.2, 3), *rng.normal(0, 0.01, 3)])
    poses = np.stack([np.linalg.matrix_power(step, k) for k in range(count)])
    if rng.random() < 0.3:
        poses[rng.integers(count)] = np.nan
    return poses


def _labels(case, rng):
    """Return labels of a frame: rectangles, of which some are ignored."""
    height, width = case.shape
    labels = np.zeros((height, width), np.uint8)
    for number in rng.choice((1, 2, 7, 254, 255), rng.integers(0, 4), replace=False):
        top, left = rng.integers(height), rng.integers(width)
        labels[top : top + 1 + height // 2, left : left + 1 + width // 2] = number
    return labels


def _stream(case, images, folder):
    rng = np.random.default_rng([*case.seed, 3])
    mask = mask_of(case, rng) if "mask" in case.given else None
    found = list(
        tisfm.reconstruct_stream(
            iter(images), camera=camera_of(case), settings=case.settings(), mask=mask,
            **case.options,
            **case.view,
        )
    )  # fmt: skip
    promises.check_stream(found, len(images), shape_of(case))


_CALLS = {
    "interpret": _interpret,
    "sequence": _sequence,
    "reconstruct": _reconstruct,
    "stream": _stream,
}
