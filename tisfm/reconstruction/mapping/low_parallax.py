"""Points that are seen from one place only, as where the camera turns: nothing tells their depth.

The way between such views is noise, and so is the depth of points that only they see. These seem
to be very near, and what is built on them has a scale of its own.
"""

from typing import Any

import numpy as np

# Share of the median depth of a view: distance to another view that sees a point. Set by hand.
MIN_BASELINE = 0.02


class LowParallaxFilter:
    """Finds the points of a model that are seen from one place only, and deletes them.

    Parameters
    ----------
    mapper : pycolmap.IncrementalMapper
    reconstruction : pycolmap.Reconstruction
        That the mapper works on.
    """

    def __init__(self, mapper: Any, reconstruction: Any) -> None:
        self._mapper, self._reconstruction = mapper, reconstruction
        self._known: set[int] = set()  # points that are seen from several places

    def delete(self, number: int) -> None:
        """Delete such points of a view, of this number.

        They come back where a view from another place sees them.
        """
        images, points = self._reconstruction.images, self._reconstruction.points3D
        image = images[number]
        # Some twice: a point's track may be in one view more than once.
        seen = list(dict.fromkeys(one.point3D_id for one in image.points2D if one.has_point3D()))
        if not seen:
            return
        pose = image.cam_from_world().matrix()
        depth = np.array([points[one].xyz for one in seen]) @ pose[2, :3] + pose[2, 3]
        least = MIN_BASELINE * float(np.median(depth))
        here = image.projection_center()
        away: dict[int, float] = {}
        for one in seen:
            if one in self._known:
                continue
            numbers = [element.image_id for element in points[one].track.elements]
            for other in numbers:
                if other not in away:
                    away[other] = float(np.linalg.norm(images[other].projection_center() - here))
            if max(away[other] for other in numbers) >= least:
                self._known.add(one)
            else:
                self._mapper.observation_manager.delete_point3D(one)
