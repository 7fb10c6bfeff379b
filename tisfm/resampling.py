"""Resampling of images: a map gives the source position of each new pixel."""

import numpy as np

from tisfm.solver.sampling import FAR, goes_to, sample
from tisfm.visibility.occlusion import leaves_image


class Resampling:
    """The map from an old image to a new image of the same size.

    Parameters
    ----------
    flow : (2, H, W) float32
        Displacement from each pixel of the new image to its source in the old image, px.
    known : (H, W) bool, optional
        Where the displacement is reliable; by default everywhere.

    Attributes
    ----------
    valid : (H, W) bool
        Where the new image has data: the source is reliable and inside the old image.
    """

    def __init__(self, flow: np.ndarray, known: np.ndarray | None = None) -> None:
        self._flow = np.clip(flow, -FAR, FAR)
        self.valid: np.ndarray = ~leaves_image(self._flow)
        if known is not None:
            self.valid &= known

    def apply(self, image: np.ndarray) -> np.ndarray:
        """Return the new image, sampled from the old one by its cubic spline.

        Parameters
        ----------
        image : (H, W) or (H, W, 3) array
            uint8, uint16 or float.

        Returns
        -------
        array of the image's shape and type
            All values lie between the image's own least and greatest value. Pixels without data
            repeat the border.
        """
        if image.ndim == 3:
            return np.stack([self.apply(channel) for channel in np.moveaxis(image, -1, 0)], axis=-1)
        values = sample(image.astype(np.float32, order="C"), self._flow)
        if np.issubdtype(image.dtype, np.integer):
            np.rint(values, out=values)
        return np.clip(values, image.min(), image.max()).astype(image.dtype, copy=False)

    def nearest(self, values: np.ndarray) -> np.ndarray:
        """Return a map of values for the new image, each from the nearest source pixel.

        Parameters
        ----------
        values : (H, W) float array
            For example depth.

        Returns
        -------
        (H, W) array of the same type
            NaN where there are no data.
        """
        height, width = self.valid.shape
        x = np.rint(self._flow[0] + np.arange(width)).clip(0, width - 1).astype(np.intp)
        y = np.rint(self._flow[1] + np.arange(height)[:, None]).clip(0, height - 1)
        return np.where(self.valid, values[y.astype(np.intp), x], values.dtype.type(np.nan))

    def missing(self, flow: np.ndarray) -> np.ndarray:
        """Return the pixels that have no data in frame 0, or move to where frame 1 has no data.

        Parameters
        ----------
        flow : (2, H, W) float32
            Image motion between two new images, px/frame.

        Returns
        -------
        (H, W) bool
        """
        return ~(self.valid & self.valid[goes_to(flow)])
