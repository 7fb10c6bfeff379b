"""What the documentation promises of results, whatever the frames show.

Every function raises `AssertionError` with a word on what is broken.
"""

import numpy as np

from tisfm import Interpretation, Reconstruction, StreamedFrame
from tisfm.formats.packing import STEP
from tisfm.status import STATUSES

WILD = ("diverged", "pose_mismatch")  # numbers may be of no use: docs/formats.md
WITHOUT_DEPTH = (
    "no_motion", "no_texture", "little_parallax", "pure_rotation", "unrelated", "aperture",
)  # fmt: skip
OF_CAMERA = ("behind_camera", "unexplained")
OF_RIGID = ("two_motions", "little_parallax", "pure_rotation", "uncertain", "contradicted")
OF_FRAMES = (
    "converged", "no_motion", "no_texture", "little_parallax", "unrelated", "uncertain",
    "contradicted", "pure_rotation", "noise", "fixed_pattern", "changing_light",
    "repeated_texture", "one_plane",
)  # fmt: skip
SCALES = ("size", "contact", "around", "none")
HALF = 2**-11  # what 11 significant bits are off by


def promise(kept, text):
    assert kept, text


def check_array(array, name, shape, kind):
    promise(array.shape == shape, f"{name} is {array.shape}, not {shape}")
    promise(array.dtype == kind, f"{name} is {array.dtype}, not {np.dtype(kind)}")


def check_depth(depth, inverse_depth):
    """Depth is 1 over an inverse depth above 0, and NaN elsewhere."""
    seen = inverse_depth > 0
    promise(np.isnan(depth[~seen]).all(), "there is depth where the inverse is not above 0")
    promise((depth[seen] > 0).all(), "depth is not above 0 somewhere")


def check_points(cloud, shape):
    promise(len(cloud) <= shape[0] * shape[1], "there are more points than pixels")
    promise(np.isfinite(cloud.positions).all(), "a point is nowhere")
    promise((cloud.positions[:, 2] > 0).all(), "a point is behind the camera")
    promise((cloud.confidence >= 0).all() and (cloud.confidence <= 1).all(), "confidence of points")


def check_interpretation(result, shape, settings, *, pose=None):
    """Check the result of a pair of frames of a shape."""
    motion, status = settings.motion, result.status
    promise(status in STATUSES, f"the status is {status!r}")
    promise(status == "converged" or status.message, f"{status} says nothing")
    promise(motion == "camera" or status not in OF_CAMERA, f"{status} under {motion}")
    promise(motion != "field" or status not in OF_RIGID, f"{status} under {motion}")
    promise(pose is not None or status != "pose_mismatch", "pose_mismatch without a pose")
    promise(result.settings == settings, "the settings are others")
    promise(result.camera.is_pinhole, "the camera is no pinhole")
    check_array(result.frame, "frame", result.frame.shape, np.uint8)
    promise(result.frame.shape[:2] == shape, f"frame is {result.frame.shape}, not {shape}")
    maps = {"rho": (6, *shape), "flow": (*shape, 2), "inverse_depth": shape, "confidence": shape}
    for name, size in maps.items():
        check_array(getattr(result, name), name, size, np.float32)
    check_array(result.occlusion, "occlusion", shape, bool)
    trust = result.confidence
    promise((trust >= 0).all() and (trust <= 1).all(), "confidence is not in [0, 1]")
    promise(not trust[result.occlusion].any(), "what is not seen has confidence")
    check_history(result.history)
    if motion == "field":
        for name in ("inverse_depth_std", "motions", "labels"):
            promise(getattr(result, name) is None, f"a field has {name}")
        if status not in WILD:
            promise((result.inverse_depth >= 0).all(), "‖τ‖ is negative")
    else:
        check_rigid(result, shape, settings, pose)
    if status not in WILD:
        for name in ("rho", "flow", "inverse_depth", "tau", "omega"):
            promise(np.isfinite(getattr(result, name)).all(), f"{name} is not finite, {status}")
        check_depth(result.depth, result.inverse_depth)
    check_points(result.points(), shape)
    check_points(result.points(min_confidence=0.5, max_depth=None, occluded=True), shape)


def check_same_frames(frame0, frame1, result):
    """Frames that are identical show exactly no motion."""
    if np.array_equal(frame0, frame1):
        promise(
            result.status in ("no_motion", "no_texture"), f"the same frames are {result.status}"
        )
        promise(not result.rho.any() and not result.flow.any(), "the same frame moves")


def check_history(history):
    lengths = {len(record) for record in vars(history).values()}
    promise(len(lengths) == 1, "the history has several lengths")
    for name, record in vars(history).items():
        promise(np.isfinite(record).all(), f"history.{name} is not finite")
    promise((history.change >= 0).all(), "a change is negative")
    promise((history.level >= 0).all() and (history.warp >= 0).all(), "a level is negative")


def check_rigid(result, shape, settings, pose):
    """Check what motions of the camera and of objects have beside."""
    status, deviation, labels = result.status, result.inverse_depth_std, result.labels
    check_array(deviation, "inverse_depth_std", shape, np.float32)
    check_array(labels, "labels", shape, np.int32)
    count = len(result.motions)
    check_array(result.motions, "motions", (count, 6), np.float64)
    most = 1 if settings.motion == "camera" else settings.max_objects
    promise(1 <= count <= most, f"there are {count} motions")
    promise(labels.min() >= 0 and labels.max() < count, "a label has no motion")
    promise(np.isinf(deviation[result.occlusion]).all(), "what is not seen has a deviation")
    if status in WILD:
        return
    promise((deviation > 0).all(), "the deviation is not above 0 somewhere")
    promise(np.isfinite(result.motions).all(), f"motions are not finite, {status}")
    if status in WITHOUT_DEPTH:
        promise(not result.inverse_depth.any(), f"there is depth, {status}")
        promise(np.isinf(deviation).all(), f"there is a deviation, {status}")
    if pose is None or len(pose) == 3:
        none = (result.inverse_depth == 0) & np.isfinite(deviation)
        promise(not none.any(), f"{none.sum()} pixels without depth have a deviation, {status}")
    if not settings.align_scales:
        lengths = np.linalg.norm(result.motions[:, :3], axis=1)
        unit = np.isclose(lengths, 1, atol=1e-5) | (lengths == 0)
        promise(unit.all(), f"‖T‖ is {lengths}")


def check_saved(result, path):
    """Saved and loaded, it is the same but for rounding; saved again, the same bytes."""
    result.save(path)
    loaded = Interpretation.load(path)
    for name in ("flow", "inverse_depth", "inverse_depth_std", "occlusion", "labels", "motions"):
        check_same(getattr(loaded, name), getattr(result, name), name)
    check_same(loaded.frame, result.frame, "frame")
    for name, record in vars(result.history).items():
        check_same(getattr(loaded.history, name), record, name)
    if result.status not in WILD:
        for name, least in (("rho", 6e-8), ("confidence", 2**-25)):
            stored, exact = getattr(loaded, name), getattr(result, name)
            off = np.abs(stored - exact) > HALF * np.abs(exact) + least
            promise(not off.any(), f"{name} was not rounded but changed")
    for name in ("camera", "settings", "status", "version"):
        check_same(getattr(loaded, name), getattr(result, name), name)
    promise(loaded.status.message == result.status.message, "the message was lost")
    first = path.read_bytes()
    loaded.save(path)
    promise(path.read_bytes() == first, "saved again, it has other bytes")
    check_compact(result, path)


def check_compact(result, path):
    """Saved compact and loaded, it is the same but for the rounding that is documented."""
    result.save(path, compact=True)
    loaded = Interpretation.load(path)
    for name in ("occlusion", "labels", "motions", "frame"):
        check_same(getattr(loaded, name), getattr(result, name), name)
    if result.status in WILD:
        return
    for name in ("rho", "flow", "confidence"):
        off = np.abs(getattr(loaded, name) - getattr(result, name).astype(np.float64))
        most = STEP if name == "confidence" else STEP / 2
        promise((off <= most + 2**-23 * np.abs(getattr(result, name))).all(), f"{name} was lost")
    for name in ("inverse_depth", "inverse_depth_std"):
        exact = getattr(result, name)
        if exact is None:
            continue
        promise((np.isinf(getattr(loaded, name)) == np.isinf(exact)).all(), f"{name} is finite")
        known = np.isfinite(exact)
        off = np.abs(getattr(loaded, name)[known] - exact[known].astype(np.float64))
        promise((off <= 2**-12 * np.abs(exact[known])).all(), f"{name} was lost")


def check_same(found, expected, name):
    """Check that both are the same, NaN included."""
    if expected is None or not isinstance(expected, np.ndarray):
        promise(found == expected, f"{name} is {found}, not {expected}")
    else:
        promise(np.array_equal(found, expected, equal_nan=found.dtype.kind == "f"), name)


def check_reconstruction(result, count, shape, *, settings, depth_of, poses=None):
    """Check the result of so many frames of a shape."""
    promise(len(result) == count, f"there are {len(result)} frames, not {count}")
    promise(result.shape == shape, f"the shape is {result.shape}")
    promise(result.camera.is_pinhole, "the camera is no pinhole")
    check_array(result.poses, "poses", (count, 4, 4), np.float64)
    check_array(result.piece, "piece", (count,), np.int32)
    pieces = sorted(set(result.piece.tolist()) - {-1})
    promise(pieces == list(range(len(result.unit))), f"pieces are {pieces} of {result.unit}")
    promise(all(u > 0 and np.isfinite(u) for u in result.unit), f"units are {result.unit}")
    for number in pieces:
        first = result.poses[result.piece == number][0]
        promise(
            poses is not None or np.allclose(first, np.eye(4), atol=1e-9),
            f"piece {number} begins elsewhere",
        )
    check_calibration(result.calibration)
    keyframes = list(result.keyframes)
    for number in pieces if poses is None else ():
        first = next((key for key in keyframes if result.piece[key] == number), None)
        if first is not None:
            middle = np.median(1 / result.inverse_depth(first)[result.inverse_depth(first) > 0])
            promise(abs(middle - 1) < 0.05, f"the median depth of frame {first} is {middle}")
    promise(keyframes == sorted(set(keyframes)), f"keyframes are {keyframes}")
    promise(all(result.piece[key] >= 0 for key in keyframes), "a keyframe has no pose")
    for frame in range(count):
        check_frame(
            result.status[frame],
            result.poses[frame],
            int(result.piece[frame]),
            result.inverse_depth(frame),
            result.inverse_depth_std(frame),
            result.depth(frame),
            result.picture(frame),
            shape,
            asked=depth_of == "all" or frame in keyframes,
        )
    if depth_of == "none":
        promise(not keyframes, "there are keyframes, though none were asked for")
    check_things(result, settings)
    points = result.points()
    promise(np.isfinite(points.positions).all(), "a point is nowhere")
    promise(len(result.points(agreeing=1, max_relative_std=1)) >= len(points), "fewer points")


def check_fused(result):
    """Check the mesh, points on a grid, and the same in another unit."""
    mesh = result.mesh(agreeing=1, max_relative_std=0.5)
    promise(np.isfinite(mesh.vertices).all(), "a vertex is nowhere")
    faces = mesh.faces
    promise(not len(faces) or 0 <= faces.min() <= faces.max() < len(mesh.vertices), "faces")
    promise(np.isfinite(mesh.voxel) and mesh.voxel >= 0, f"the voxel is {mesh.voxel}")
    points = result.points(agreeing=1, max_relative_std=0.5)
    promise(len(result.points(agreeing=1, max_relative_std=0.5, voxel=0.1)) <= len(points), "grid")
    placed = np.flatnonzero(result.piece == result.largest_piece)
    moved = (
        np.linalg.norm(np.diff(result.poses[placed][[0, -1], :3, 3], axis=0)) if len(placed) else 0
    )
    if moved == 0:
        return
    scaled = result.rescaled(placed[0], placed[-1], 2 * moved)
    for frame in placed:
        expected = result.inverse_depth(frame) / 2
        off = np.abs(scaled.inverse_depth(frame) - expected) > 1e-5 * np.abs(expected)
        promise(not off.any(), "rescaled, it has another depth")


def check_frame(
    status, pose, piece, inverse_depth, deviation, depth, picture, shape, *, asked=True
):
    """Check what is said of a frame of a sequence."""
    promise(status in OF_FRAMES, f"the status of a frame is {status!r}")
    promise(status == "converged" or status.message, f"{status} says nothing")
    check_array(inverse_depth, "inverse_depth", shape, np.float32)
    check_array(deviation, "inverse_depth_std", shape, np.float32)
    check_array(picture, "picture", picture.shape, np.uint8)
    promise(picture.shape[:2] == shape, f"the picture is {picture.shape}")
    promise(not np.isinf(inverse_depth).any(), "an inverse depth is infinite")
    promise((deviation > 0).all(), "the deviation is not above 0 somewhere")
    promise(np.isinf(deviation[np.isnan(inverse_depth)]).all(), "no depth, but a deviation")
    check_depth(depth, inverse_depth)
    if piece < 0:
        promise(np.isnan(pose).all(), "a frame of no piece has a pose")
        promise(np.isnan(inverse_depth).all(), "a frame of no piece has depth")
        promise(status != "converged", "a frame of no piece has converged")
        return
    turn = pose[:3, :3]
    promise(np.isfinite(pose).all(), "a pose is not finite")
    promise(np.allclose(turn @ turn.T, np.eye(3), atol=1e-3), "a pose is not rigid")
    promise(np.linalg.det(turn) > 0, "a pose mirrors")
    promise(np.allclose(pose[3], (0, 0, 0, 1)), "a pose has another last row")
    promise(status in ("converged", "little_parallax"), f"a frame with a pose is {status}")
    if asked:
        seen = not np.isnan(inverse_depth).all()
        promise(seen == (status == "converged"), f"a frame that has {seen} depth is {status}")


def check_calibration(found):
    promise(found.origin in ("given", "estimated", "guessed"), f"origin is {found.origin}")
    promise(found.focal_std >= 0, f"focal_std is {found.focal_std}")
    promise(found.focal is not None and found.focal > 0, f"focal is {found.focal}")
    promise(found.shape is not None, "the size of the frames of the source is not said")
    promise(found.origin == "given" or found.message, "the calibration says nothing")
    promise(found.origin != "guessed" or not found.seen, "a guess is relied on")
    values = (found.radial, found.radial_std, found.readout, found.readout_std)
    promise(np.isfinite(values).all(), f"radial or readout are {values}")
    promise(abs(found.readout) <= 1, f"the readout is {found.readout}")


def check_things(result, settings):
    """Check labels, and what is said of what moves."""
    ids = [thing.id for thing in result.objects]
    promise(ids == sorted(set(ids)), f"ids are {ids}")
    promise(settings.motion == "objects" or not ids, "things move")
    seen = {number: [] for number in ids}
    for frame in range(len(result)):
        labels = result.labels(frame)
        check_array(labels, "labels", result.shape, np.uint8)
        for number in set(np.unique(labels).tolist()) - {0}:
            promise(number in seen, f"label {number} is of no thing")
            rows, columns = np.nonzero(labels == number)
            left, top = int(columns.min()), int(rows.min())
            box = [left, top, int(columns.max()) - left + 1, int(rows.max()) - top + 1]
            seen[number].append((frame, box))
    for thing in result.objects:
        count = len(thing.frames)
        check_array(thing.boxes, "boxes", (count, 4), np.int32)
        check_array(thing.poses, "poses of a thing", (count, 4, 4), np.float64)
        boxes = list(zip(thing.frames, thing.boxes.tolist(), strict=True))
        promise(boxes == seen[thing.id], f"boxes of {thing.id} are {boxes}, not {seen[thing.id]}")
        promise(thing.scale_from in SCALES, f"the scale is from {thing.scale_from}")
        known = np.isfinite(thing.poses).all(axis=(1, 2))
        promise(np.isnan(thing.poses[~known]).all(), "a pose of a thing is infinite, or half NaN")
        if known.any():
            promise((thing.extent > 0).all(), f"the extent is {thing.extent}")
        else:
            promise(np.isnan(thing.extent).all(), "a thing without poses has an extent")
            promise(thing.scale_from == "none" and thing.message, "a thing without poses says so")


def check_copied(result, folder):
    """Saved and loaded, it is the same."""
    result.save(folder)
    loaded = Reconstruction.load(folder)
    for name in ("poses", "piece", "position_deviation", "rotation_deviation"):
        check_same(getattr(loaded, name), getattr(result, name), name)
    for name in ("unit", "keyframes", "camera", "settings", "names", "shape", "version"):
        check_same(getattr(loaded, name), getattr(result, name), name)
    for name in ("status", "calibration"):
        check_same(getattr(loaded, name), getattr(result, name), name)
    promise(len(loaded.objects) == len(result.objects), "things were lost")
    for found, thing in zip(loaded.objects, result.objects, strict=True):
        for name in ("id", "frames", "boxes", "poses", "extent", "scale_from", "message"):
            check_same(getattr(found, name), getattr(thing, name), f"{name} of a thing")
    for frame in range(len(result)):
        for name in ("inverse_depth", "inverse_depth_std", "depth", "labels", "picture"):
            of = (getattr(each, name)(frame) for each in (loaded, result))
            check_same(*of, f"{name} of frame {frame}")


def check_stream(found, count, shape):
    """Check the frames of a stream."""
    promise([frame.index for frame in found] == list(range(count)), "frames are not in order")
    for frame in found:
        promise(isinstance(frame, StreamedFrame), "it is no frame of a stream")
        check_frame(
            frame.status,
            frame.pose,
            frame.piece,
            frame.inverse_depth,
            frame.inverse_depth_std,
            frame.depth,
            frame.picture,
            shape,
        )
        promise(not frame.keyframe or frame.piece >= 0, "a keyframe has no pose")
        check_calibration(frame.calibration)
