"""Labels of pixels as colours over the picture."""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError, InputTypeError
from tisfm.show.arrays import as_image, as_uint8, require_same_size
from tisfm.show.palette import category_colors, colors_of_categories

_LABEL_OPACITY = 0.55  # weight of the colour of a label against the picture; set by hand
_PICTURE_WIDTH_PER_LINE = 400  # px of picture width for each px of line width; set by hand


def label_colors(count: int) -> NDArray[np.uint8]:
    """Return a colour for each label: light grey for 0, the background.

    People with a colour vision deficiency can tell the colours apart.

    Parameters
    ----------
    count : int
        Number of labels.

    Returns
    -------
    (count, 3) uint8 ndarray
        Red, green, blue. The colour of a label does not depend on the number of labels. Colours
        repeat after 15 labels.

    Raises
    ------
    ValueError
        If `count` is less than 1.

    Examples
    --------
    >>> from tisfm.show import label_colors
    >>> label_colors(4).shape
    (4, 3)
    """
    if count < 1:
        raise InputError(f"count is {count}, expected 1 or more labels")
    return category_colors(count)


def label_overlay(image: ArrayLike, labels: ArrayLike) -> NDArray[np.uint8]:
    """Tint a picture by labels, and draw the boundaries between the labels.

    Pixels of label 0 are grey, others have the colours of `label_colors`.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        Picture: uint8, uint16 or float.
    labels : (H, W) array_like of int
        Labels from 0.

    Returns
    -------
    (H, W, 3) uint8 ndarray
        Red, green, blue.

    Raises
    ------
    TypeError, ValueError
        If a shape is wrong, sizes differ, a value is masked, or labels are not integers from 0.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import label_overlay
    >>> scene = two_blocks(48, 64)
    >>> label_overlay(scene.frame0, scene.labels).shape
    (48, 64, 3)
    """
    (picture,) = as_uint8(as_image("image", image))
    label_map = check_unmasked(
        labels, "labels", advice="fill them first, for instance by labels.filled(0)"
    )
    if label_map.dtype.kind not in "iu":
        raise InputTypeError(f"labels has dtype {label_map.dtype}, expected integers")
    if label_map.ndim != 2:
        raise InputError(f"labels is {label_map.shape}, expected (H, W)")
    require_same_size("labels", label_map, "image", picture)
    if label_map.min() < 0:
        raise InputError(f"labels has {label_map.min()}, expected integers from 0")
    grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    overlay = np.repeat(grey.astype(np.float32)[..., None], 3, axis=2)
    is_object = label_map > 0
    colors = colors_of_categories(label_map[is_object])
    overlay[is_object] += np.float32(_LABEL_OPACITY) * (colors - overlay[is_object])
    overlay[_boundaries(label_map)] = 255
    return np.rint(overlay).astype(np.uint8)


def _boundaries(labels: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return the mask of lines between different labels; wider lines in larger pictures."""
    edge = np.zeros(labels.shape, np.uint8)
    edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    edge[1:] |= labels[1:] != labels[:-1]
    width = max(1, round(labels.shape[1] / _PICTURE_WIDTH_PER_LINE))
    return cv2.dilate(edge, np.ones((width, width), np.uint8)).astype(bool)
