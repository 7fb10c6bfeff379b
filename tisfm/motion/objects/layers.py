"""Layers: the images decide which of several rigid motions each pixel has.

A layer's surface is fitted to the pixels with its label and continued smoothly beyond them. There,
a pixel takes the label of the surface that fits the images best.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.motion.egomotion import TooFewPixelsError, camera_motion
from tisfm.motion.objects.candidates import floating_parts, smallest_object
from tisfm.motion.objects.label_optimisation import Potts
from tisfm.motion.objects.settings import OBJECTS
from tisfm.motion.rigid_depth import (
    RigidSolution,
    motion_residual,
    rigid_depth,
    scaled_translations,
)
from tisfm.motion.settings import DEPTH
from tisfm.motion.textureless_depth import texture_weight, textureless_depth, textureless_share
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.visibility.confidence import MIN_RESIDUAL, MIN_RESIDUAL_GREY
from tisfm.visibility.occlusion import leaves_image, pyramid_occlusion


@dataclass(frozen=True, kw_only=True)
class Layers:
    """Rigid motions and a label for every pixel."""

    motions: list[np.ndarray]  # list of (3, 4) array
    labels: np.ndarray  # (H, W) int32
    hidden: np.ndarray  # (H, W) bool: pixels of frame 0 that are not visible in frame 1
    costs: np.ndarray  # (K, H, W) float32: cost of each layer, in units of cost
    # squared residual of a unit of cost: px² if constraints are normalised, else squared grey
    # levels
    unit: float
    flows: np.ndarray  # (K, 2, H, W) float32: flow of each layer's surface, at every pixel
    is_allowed: np.ndarray  # (K, H, W) bool: pixels that may have each motion
    # (H, W) int32: parts of the background (label 0) that would float if they were at rest
    # (`floating_parts`), numbered from 1
    floating: np.ndarray


@dataclass(frozen=True, kw_only=True)
class _Surface:
    """A surface fitted on its support, its residual averaged over windows, and its flow."""

    support: np.ndarray  # (H, W) bool
    solution: RigidSolution
    residual: np.ndarray  # (H, W) float32: squared
    flow: np.ndarray  # (2, H, W) float32: px/frame


class Layering:
    """Fits layers to a pair of frames and removes layers that are not needed."""

    def __init__(
        self,
        pyramid: ImagePyramid,
        settings: Settings,
        grey0: np.ndarray,  # (H, W) float32: grey levels of frame 0
        *,
        # sampling density of the finest level divided by that of the original frames
        density: float = 1.0,
    ) -> None:
        self._pyramid = pyramid
        # Rough surfaces suffice to separate layers.
        self._settings = replace(settings, warps=1, coarse_warps=min(2, settings.coarse_warps))
        self._potts = Potts(grey0, density=density)
        self._min_residual = (
            MIN_RESIDUAL if settings.depth_normalization is not None else MIN_RESIDUAL_GREY
        )
        self.min_size = smallest_object(grey0.size)
        frame, valid = pyramid.frames0[pyramid.last], pyramid.valid0(pyramid.last)
        is_textureless = textureless_share(frame, valid) >= DEPTH.min_textureless_share
        self._weight = np.ones_like(grey0)
        if is_textureless:
            self._weight = texture_weight(grey0, valid=pyramid.valid0(0))
        self._is_textureless = is_textureless
        self._surfaces: dict[bytes, list[_Surface]] = {}  # for every motion, oldest first

    def fit(
        self,
        motions: list[np.ndarray],  # list of (3, 4) array
        labels: np.ndarray,  # (H, W) int32
        hidden: np.ndarray,  # (H, W) bool
        *,
        # (K, H, W) bool: pixels that may have each motion, by default all
        is_allowed: np.ndarray | None = None,
        rounds: int = 2,  # number of alternations; a single motion needs one only
    ) -> Layers:
        """Return the layers after fitting surfaces and labels alternately."""
        if is_allowed is None:
            is_allowed = np.ones((len(motions), *labels.shape), bool)
        for _ in range(rounds if len(motions) > 1 else 1):
            residuals, flows = [], []
            for label, motion in reversed(list(enumerate(motions))):
                surface = self._fit_surface(motion, _erode(labels == label) & ~hidden)
                residuals.append(surface.residual)
                flows.append(surface.flow)
            background_surface = surface
            flows.reverse()
            stacked_residuals, stacked_flows = np.stack(residuals[::-1]), np.stack(flows)
            own_residual = np.take_along_axis(stacked_residuals, labels[None], axis=0)[0]
            valid = self._pyramid.valid0(0)
            median_residual = float(
                np.median(own_residual if valid is None else own_residual[valid])
            )
            unit = OBJECTS.cost_unit * max(median_residual, self._min_residual**2)
            costs = np.minimum(stacked_residuals / unit, OBJECTS.max_layer_cost)
            # Where a layer's flow leaves the image, it takes the least cost of the other layers.
            leaves = np.stack([leaves_image(flow) for flow in flows])
            min_cost = (
                np.where(leaves, np.inf, costs).min(axis=0).clip(None, OBJECTS.max_layer_cost)
            )
            costs = np.where(leaves, min_cost, costs).astype(np.float32)
            costs[~is_allowed] = OBJECTS.forbidden_layer_cost
            own_flow = np.take_along_axis(stacked_flows, labels[None, None], axis=0)[0]
            hidden = pyramid_occlusion(self._pyramid, own_flow, self._settings)
            weight = np.where(hidden, OBJECTS.hidden_weight, OBJECTS.visible_weight).astype(
                np.float32
            )
            labels = self._potts.assign(costs, weight)
        return Layers(
            motions=motions,
            labels=labels,
            hidden=hidden,
            costs=costs,
            unit=unit,
            flows=stacked_flows,
            is_allowed=is_allowed,
            floating=self._floating_parts(background_surface.solution) * (labels == 0),
        )

    def add_floating_parts(self, layers: Layers, *, max_layers: int) -> Layers:
        """Return the layers plus one for each part that floats in front of the background.

        There are `max_layers` layers at most. A floating part moves along the background's epipolar
        lines, so its layer starts with the background's motion and a surface of its own. That
        motion also explains the background, so the layer is confined to the part and a margin.
        """
        parts = range(1, 1 + min(max_layers - len(layers.motions), int(layers.floating.max())))
        if not parts:
            return layers
        labels = layers.labels.copy()
        margin = 1 + 2 * round(OBJECTS.floating_margin * max(labels.shape))
        window = np.ones((margin, margin), np.uint8)
        is_allowed = list(layers.is_allowed)
        for part in parts:
            is_part = layers.floating == part
            labels[is_part] = len(is_allowed)
            is_allowed.append(cv2.dilate(is_part.astype(np.uint8), window) > 0)
        motions = layers.motions + [layers.motions[0]] * len(parts)
        return self.prune(self.fit(motions, labels, layers.hidden, is_allowed=np.stack(is_allowed)))

    def prune(self, layers: Layers) -> Layers:
        """Return the layers that are needed.

        Layers that are too small are removed first. Then every other layer but the first is
        removed on trial, and the layer with the least gain is dropped, until all layers are needed.
        The layer with the least gain goes first, because an object may have lost its pixels to it.
        A layer that was needed once stays needed, because fewer layers are left to replace it.
        """
        needed_labels = {0}
        while len(needed_labels) < len(layers.motions):
            areas = np.bincount(layers.labels.ravel(), minlength=len(layers.motions))
            candidates = [label for label in range(len(areas)) if label not in needed_labels]
            weakest_label = min(candidates, key=lambda label: areas[label])
            if areas[weakest_label] < self.min_size:
                layers = self._remove_layer(layers, weakest_label)
            else:
                trials = {label: self._remove_layer(layers, label) for label in candidates}
                gains = {
                    label: self._relative_gain(layers, label, trial)
                    for label, trial in trials.items()
                }
                needed_labels |= {label for label in candidates if gains[label] >= 1}
                weakest_label = min(candidates, key=lambda label: gains[label])
                if weakest_label in needed_labels:
                    break
                layers = trials[weakest_label]
            needed_labels = {label - (label > weakest_label) for label in needed_labels}
        return layers

    def _remove_layer(self, layers: Layers, label: int) -> Layers:
        """Return the layers without the layer of a label, fitted anew."""
        other_labels = [k for k in range(len(layers.motions)) if k != label]
        weight = np.where(layers.hidden, OBJECTS.hidden_weight, OBJECTS.visible_weight).astype(
            np.float32
        )
        return self.fit(
            [layers.motions[k] for k in other_labels],
            self._potts.assign(layers.costs[other_labels], weight),
            layers.hidden,
            is_allowed=layers.is_allowed[other_labels],
            rounds=1,
        )

    def _relative_gain(self, layers: Layers, label: int, pruned_layers: Layers) -> float:
        """Return the gain of a layer on its own pixels, 1 or more if the layer is needed.

        For a layer that was added as a floating part, the background's surface is continued from
        the surroundings of the part. If frames are partly textureless, gains are weighted by
        texture, and the background may also have the depth that is matched and carried
        (`textureless_depth`).
        """
        is_visible_layer = (layers.labels == label) & ~layers.hidden & ~pruned_layers.hidden
        own_cost, rival_cost = _own_cost(layers), _own_cost(pruned_layers)
        is_floating = not layers.is_allowed[label].all()
        if is_floating:
            rival_cost = np.where(pruned_layers.floating > 0, layers.costs[0], rival_cost)
        gain = self._gain_ratio(rival_cost - own_cost, is_visible_layer)
        if gain < 1 or is_floating or not self._is_textureless:
            return gain
        return self._gain_ratio(
            np.minimum(rival_cost, self._carried_cost(pruned_layers)) - own_cost, is_visible_layer
        )

    def _gain_ratio(self, gain: np.ndarray, mask: np.ndarray) -> float:
        """Return the total gain of a mask's pixels divided by the least gain of a needed layer."""
        total = float((self._weight * gain)[mask].sum())
        return total / max(
            OBJECTS.min_object_gain * self.min_size, OBJECTS.min_pixel_gain * int(mask.sum())
        )

    def _carried_cost(self, layers: Layers) -> np.ndarray:
        """Return the background's cost with carried depth, (H, W); inf without such depth."""
        pyramid = self._pyramid
        is_background = layers.labels == 0
        zeros = np.zeros(is_background.shape, np.int32)
        motion = scaled_translations(layers.motions[0][None], zeros, pyramid.cameras[0])[0]
        carried_solution = None
        if motion[:, 3].any():
            support = _erode(is_background) & ~layers.hidden
            carried_solution = textureless_depth(pyramid, self._settings, motion, support=support)
        if carried_solution is None:
            return np.full(is_background.shape, np.inf, np.float32)
        residual, flow = self._residual(carried_solution)
        cost = cv2.blur(residual, (OBJECTS.layer_window, OBJECTS.layer_window)) / np.float32(
            layers.unit
        )
        return np.where(
            is_background & ~leaves_image(flow), np.minimum(cost, OBJECTS.max_layer_cost), np.inf
        )

    def refit_motions(
        self, layers: Layers, flow: np.ndarray, trust: np.ndarray
    ) -> list[np.ndarray]:
        """Return the motions fitted to a flow field within their layers, (3, 4) each.

        The background's motion ignores floating parts. A motion stays if it has no
        translation or if its layer has too few trusted pixels.
        """
        motions = []
        for label, motion in enumerate(layers.motions):
            if not motion[:, 3].any():
                motions.append(motion)
                continue
            is_core = _erode((layers.labels == label) & (layers.floating == 0)) & ~layers.hidden
            try:
                likely_rotation = layers.motions[0][:, :3] if label else None
                camera = self._pyramid.cameras[0]
                motion_fit = camera_motion(
                    flow, np.where(is_core, trust, 0), camera, likely_rotation=likely_rotation
                )
            except TooFewPixelsError:
                motions.append(motion)
                continue
            motions.append(np.column_stack([motion_fit.rotation, motion_fit.translation]))
        return motions

    def _fit_surface(self, motion: np.ndarray, support: np.ndarray) -> "_Surface":
        """Return the surface of a motion fitted on a support.

        A surface that was fitted on nearly the same pixels is reused.
        """
        surfaces = self._surfaces.setdefault(motion.tobytes(), [])
        max_changes = OBJECTS.max_support_change * np.count_nonzero(support)
        for surface in reversed(surfaces):
            if np.count_nonzero(surface.support ^ support) <= max_changes:
                return surface
        solution = self._fit_depth(motion, support)
        residual, flow = self._residual(solution)
        mean_residual = cv2.blur(residual, (OBJECTS.layer_window, OBJECTS.layer_window))
        surfaces.append(
            _Surface(support=support, solution=solution, residual=mean_residual, flow=flow)
        )
        return surfaces[-1]

    def _fit_depth(self, motion: np.ndarray, support: np.ndarray) -> RigidSolution:
        """Return a surface fitted on its support and continued to all pixels."""
        return rigid_depth(
            self._pyramid,
            self._settings,
            motion[None],
            np.zeros(support.shape, np.int32),
            refine="none",
            support=support,
        )

    def _residual(self, surface: RigidSolution) -> tuple[np.ndarray, np.ndarray]:
        """Return residual and flow of a surface at all pixels."""
        return motion_residual(
            self._pyramid, self._settings, surface.motions[0], surface.inverse_depth
        )

    def _floating_parts(self, surface: RigidSolution) -> np.ndarray:
        """Return the numbered parts of a surface that float."""
        if not surface.motions[0, :, 3].any():
            return np.zeros(surface.inverse_depth.shape, np.int32)
        deviation = surface.deviation()
        return floating_parts(surface.inverse_depth, deviation, self.min_size)


def remove_specks(
    labels: np.ndarray,  # (H, W) int32
    min_size: int,  # fewest pixels of a part
) -> np.ndarray:
    """Return the labels, where small connected parts take the nearest other label.

    If all parts of a label are small, its largest part stays.
    """
    is_large = np.zeros(labels.shape, bool)
    for label in np.unique(labels):
        parts = cv2.connectedComponents((labels == label).astype(np.uint8), connectivity=4)[1]
        areas = np.bincount(parts.ravel())
        is_large_part = areas >= min_size
        is_large_part[0] = False
        if not is_large_part.any():
            is_large_part[1 + int(np.argmax(areas[1:]))] = True
        is_large |= is_large_part[parts]
    return np.where(is_large, labels, fill_nearest(labels, is_large))


def fill_nearest(values: np.ndarray, is_known: np.ndarray) -> np.ndarray:
    """Return the value of the nearest known pixel for every pixel, (H, W)."""
    _, nearest = cv2.distanceTransformWithLabels(
        (~is_known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    values_by_pixel = np.zeros(int(nearest.max()) + 1, values.dtype)
    values_by_pixel[nearest[is_known]] = values[is_known]
    return values_by_pixel[nearest]


def _erode(mask: np.ndarray) -> np.ndarray:
    """Return a mask without its rim, or the whole mask if fewer than 64 pixels would remain."""
    interior = (
        cv2.erode(
            mask.astype(np.uint8), np.ones((OBJECTS.layer_window, OBJECTS.layer_window), np.uint8)
        )
        > 0
    )
    return interior if interior.sum() >= 64 else mask


def _own_cost(layers: Layers) -> np.ndarray:
    return np.take_along_axis(layers.costs, layers.labels[None], axis=0)[0]
