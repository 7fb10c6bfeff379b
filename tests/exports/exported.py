"""Truth of rendered films, and what pycolmap makes of a model."""

import numpy as np
import pycolmap


def predicted(positions, pose, shape):
    """Return where a camera sees points of the world, (N, 2), px."""
    local = (positions - pose.matrix[:3, 3]) @ pose.matrix[:3, :3]
    return local[:, :2] / local[:, 2:] * pose.camera.focal + pose.camera.center_for(*shape)


def true_places(film, points, frame, others):
    """Return where other frames see what is at pixels of a frame, (N, len(others), 2).

    NaN where something else is in front, or it is outside.
    """
    column, row = points.astype(int).T
    cx, cy = film.camera.center_for(*film.depth[0].shape)
    z = film.depth[frame][row, column]
    local = np.stack(
        [
            (points[:, 0] - cx) / film.camera.focal * z,
            (points[:, 1] - cy) / film.camera.focal * z,
            z,
        ],
        axis=1,
    )
    world = local @ film.poses[frame][:3, :3].T + film.poses[frame][:3, 3]
    height, width = film.depth[0].shape
    places = np.full((len(points), len(others), 2), np.nan)
    for k, other in enumerate(others):
        there = (world - film.poses[other][:3, 3]) @ film.poses[other][:3, :3]
        at = there[:, :2] / there[:, 2:] * film.camera.focal + (cx, cy)
        near = np.rint(at).astype(int).clip(0, (width - 1, height - 1))
        seen = np.abs(film.depth[other][near[:, 1], near[:, 0]] / there[:, 2] - 1) < 0.02
        seen &= ((at >= 0) & (at <= (width - 1, height - 1))).all(axis=1)
        places[seen, k] = at[seen]
    return places


def errors_of(tracks, film):
    """Return how far places of tracks are from the truth, px, without the frames they begin in.

    These are known by their positions, which are those of pixels.
    """
    errors = []
    whole = (tracks.image_points == np.rint(tracks.image_points)).all(axis=1)
    for point in range(len(tracks)):
        first, last = np.searchsorted(tracks.points, (point, point + 1))
        begun = first + np.flatnonzero(whole[first:last])
        if len(begun) != 1:
            continue
        others = np.array([k for k in range(first, last) if k != begun[0]])
        frames = tracks.frames[others]
        true = true_places(film, tracks.image_points[begun], tracks.frames[begun[0]], frames)[0]
        errors.append(np.linalg.norm(tracks.image_points[others] - true, axis=1))
    errors = np.concatenate(errors)
    return errors[np.isfinite(errors)]


def retriangulated(model):
    """Return reprojection errors, px, of points that pycolmap finds from positions and poses."""
    errors, lost = [], 0
    for point in model.points3D.values():
        images = [model.images[e.image_id] for e in point.track.elements]
        places = np.array(
            [
                image.points2D[e.point2D_idx].xy
                for image, e in zip(images, point.track.elements, strict=True)
            ]
        )
        cameras = [model.cameras[image.camera_id] for image in images]
        found = pycolmap.estimate_triangulation(
            places, [image.cam_from_world() for image in images], cameras
        )
        if found is None:
            lost += 1
            continue
        for image, place in zip(images, places, strict=True):
            there = image.project_point(found["xyz"])
            errors.append(np.inf if there is None else np.linalg.norm(there - place))
    return np.array(errors), lost


def tracks_per_image(model, length=3):
    """Return, by the name of each image, how many tracks of so many frames or more it sees."""
    return {
        image.name: sum(
            point.has_point3D() and model.points3D[point.point3D_id].track.length() >= length
            for point in image.points2D
        )
        for image in model.images.values()
    }


def contents(model):
    """Return all that a model says, as plain values, by name and by number."""
    images = {
        image.name: (
            image.image_id,
            image.camera_id,
            image.cam_from_world().matrix().tolist(),
            [(point.xy.tolist(), point.point3D_id) for point in image.points2D],
        )
        for image in model.images.values()
    }
    points = {
        number: (
            point.xyz.tolist(),
            point.color.tolist(),
            point.error,
            sorted((e.image_id, e.point2D_idx) for e in point.track.elements),
        )
        for number, point in model.points3D.items()
    }
    cameras = {
        number: (camera.model.name, camera.width, camera.height, camera.params.tolist())
        for number, camera in model.cameras.items()
    }
    return {"images": images, "points": points, "cameras": cameras}
