"""Removal of points that are seen from one camera position only: they show no depth.

Where the camera only rotates, the translation between views is noise, and so is the depth of points
that only these views see. Such points seem very near, and views added from them get a wrong scale.
"""

from typing import Any

import numpy as np

# Smallest distance to another view that sees a point, as a share of a view's median depth. Set by
# hand.
MIN_BASELINE = 0.02


class LowParallaxFilter:
    """Deletes the points of a model that are seen from one camera position only."""

    def __init__(
        self,
        mapper: Any,
        reconstruction: Any,  # the reconstruction that the mapper works on
    ) -> None:
        self._mapper, self._reconstruction = mapper, reconstruction
        self._known: set[int] = set()  # points that are seen from several positions

    def delete(self, number: int) -> None:
        """Delete such points of the view with this number.

        A deleted point may be triangulated again with a view from another position.
        """
        images, points = self._reconstruction.images, self._reconstruction.points3D
        image = images[number]
        # Without repetition: the track of a point may contain two observations of one view.
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
