"""Resampling of images: a map gives the source position of each new pixel."""

import numpy as np

from tisfm.solver.sampling import FAR_FLOW, sample, target_pixels
from tisfm.visibility.occlusion import leaves_image


class Resampling:
    """The map from an old image to a new image of the same size."""

    def __init__(
        self,
        # (2, H, W) float32: displacement from each pixel of the new image to its source in the old
        # image, px
        flow: np.ndarray,
        # (H, W) bool: where the displacement is reliable; by default everywhere
        is_reliable: np.ndarray | None = None,
    ) -> None:
        self._flow = np.clip(flow, -FAR_FLOW, FAR_FLOW)
        # (H, W) bool: pixels of the new image with data: a reliable source inside the old image
        self.valid: np.ndarray = ~leaves_image(self._flow)
        if is_reliable is not None:
            self.valid &= is_reliable

    def apply(
        self,
        image: np.ndarray,  # (H, W) or (H, W, 3) array: uint8, uint16 or float
    ) -> np.ndarray:
        """Return the new image, sampled from the old one by its cubic spline.

        The result has the type of the image and the shape of the map. Its values lie between the
        smallest and the greatest value of the image. Pixels without data repeat the border.
        """
        if image.ndim == 3:
            return np.stack([self.apply(channel) for channel in np.moveaxis(image, -1, 0)], axis=-1)
        values = sample(image.astype(np.float32, order="C"), self._flow)
        if np.issubdtype(image.dtype, np.integer):
            np.rint(values, out=values)
        return np.clip(values, image.min(), image.max()).astype(image.dtype, copy=False)

    def apply_nearest(
        self,
        values: np.ndarray,  # (H, W) float array: for example depth
    ) -> np.ndarray:  # (H, W) array of the same type: NaN where there are no data
        """Return a map of values for the new image, each from the nearest source pixel."""
        height, width = self.valid.shape
        x = np.rint(self._flow[0] + np.arange(width)).clip(0, width - 1).astype(np.intp)
        y = np.rint(self._flow[1] + np.arange(height)[:, None]).clip(0, height - 1)
        return np.where(self.valid, values[y.astype(np.intp), x], values.dtype.type(np.nan))

    def pixels_without_data(
        self,
        flow: np.ndarray,  # (2, H, W) float32: image motion between two new images, px/frame
    ) -> np.ndarray:  # (H, W) bool
        """Return the pixels that have no data in frame 0, or where they move to in frame 1."""
        return ~(self.valid & self.valid[target_pixels(flow)])


class ZoomRemoval(Resampling):
    """The map from a frame to the same frame with another focal length."""

    def __init__(
        self,
        zoom: float,  # focal length of the old frame over that of the new frame
        center: tuple[float, float],  # (cx, cy): principal point, px
        shape: tuple[int, int],  # height and width, px
    ) -> None:
        height, width = shape
        flow = np.empty((2, height, width), np.float32)
        flow[0] = (zoom - 1) * (np.arange(width) - center[0])
        flow[1] = (zoom - 1) * (np.arange(height) - center[1])[:, None]
        super().__init__(flow)
