"""Coarse to fine: every level starts from the solution of the next coarser level."""

import numpy as np

from bench.reference.data import constancy_tensors, flow, motion_matrix
from bench.reference.images import derivatives, warp
from bench.reference.minimisation import minimise
from bench.reference.smoothness import Smoothness, image_edges, mean_step
from tisfm.camera import Camera
from tisfm.settings import Settings

Array = np.ndarray  # of float64


def prolong(coarse: Array, shape: tuple[int, int], ratio: float) -> Array:
    """Return ρ̂ of a coarser level, (n, h, w), on a finer grid of `shape`, bilinearly.

    Pixel x of the fine grid lies at (x + ½)·ratio − ½ on the coarse one, and ρ̂, in pixels of its
    level, is divided by `ratio`.
    """

    def positions(count: int, size: int) -> tuple[Array, Array, Array]:
        x = np.clip((np.arange(count) + 0.5) * ratio - 0.5, 0, size - 1)
        first = np.minimum(x.astype(int), max(size - 2, 0))
        return first, np.minimum(first + 1, size - 1), x - first

    top, bottom, down = positions(shape[0], coarse.shape[1])
    left, right, across = positions(shape[1], coarse.shape[2])
    columns = coarse[:, :, left] * (1 - across) + coarse[:, :, right] * across
    down = down[:, None]
    return (columns[:, top] * (1 - down) + columns[:, bottom] * down) / ratio


def coarse_to_fine(
    pyramid0: list[Array], pyramid1: list[Array], camera: Camera, settings: Settings
) -> Array:
    """Return ρ̂, (n, H, W), of the finest of the given levels, the finest first.

    `camera` belongs to the finest level; the pyramid settings have no effect here.
    """
    n, factor = settings.components, settings.pyramid_factor
    height, width = pyramid0[0].shape
    epsilon = np.inf if settings.data_contrast is None else settings.data_contrast
    scales = [m * epsilon**2 for m in (settings.brightness, settings.gradient) if m > 0]
    normalization = settings.normalization
    if normalization is not None:
        normalization *= mean_step(pyramid0[0])
    rho: Array | None = None
    last = min(settings.finest_level, len(pyramid0) - 1)
    for level in reversed(range(last, len(pyramid0))):
        frame0, frame1 = pyramid0[level], pyramid1[level]
        shape = frame0.shape
        rho = np.zeros((n, *shape)) if rho is None else prolong(rho, shape, factor)
        motion = motion_matrix(camera.scaled(factor**level, height, width), shape[0], shape[1], n)
        smoothness = Smoothness(
            contrast=settings.contrast_for(camera.focal),
            stiffness=np.array(settings.stiffness[:n]),
            joint=settings.joint_edges,
            edges=image_edges(frame0, settings.image_edges) if settings.image_edges > 0 else None,
        )
        for _ in range(settings.warps_on(level - last)):
            flow0 = flow(motion, rho)
            warped, mask = warp(frame1, flow0)
            gradients = derivatives(frame0, warped, settings.derivatives, halo=2)
            terms = constancy_tensors(
                gradients,
                flow0,
                mask,
                brightness=settings.brightness,
                gradient=settings.gradient,
                normalization=normalization,
            )
            minimise(
                terms,
                motion,
                rho,
                alpha=settings.alpha,
                smoothness=smoothness,
                scales=scales,
                outer_iterations=settings.outer_iterations,
                sweeps=settings.sweeps,
                relaxation=settings.relaxation,
                tolerance=settings.tolerance,
                thorough=settings.pyramid_levels == 1,
            )
    if rho is None:
        raise ValueError("pyramids are empty: expected at least one level")
    return rho if last == 0 else prolong(rho, (height, width), factor**last)
