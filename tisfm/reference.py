"""The method in plain NumPy float64, to be read beside the paper and tested against.

Nothing here is fast: every function is the equation it cites, on arrays of shape (…, H, W).
ρ̂ = f·ρ is in px/frame and coordinates are normalised, x̂ = x/f, so that eq. 2 becomes
(u, v)ᵀ = G ρ̂ and the paper's λ becomes λ̂ = λ/f².

Departures from the paper, beyond that scaling:

- eq. 10 on edges: b belongs to the difference of two neighbours, as in eq. 14, so that the
  iteration majorises and minimises one energy exactly;
- a contrast δ in eq. 10: Φ_δ(s) = 2δ²(√(1 + s²/δ²) − 1); the paper has δ = 1 in the units of τ;
- robust weights of the data, gradient constancy, normalised constraints, image-driven edges and
  a stiffness of each component, all as `tisfm.Settings` describes them, none in the paper;
- a warp: frame 1 is brought to frame 0 by the current flow before derivatives are taken.

Errata of the paper: the third line of eq. 18 must read s3, not s1; eq. 9 minimises b·a² + ψ(b);
the field b under eq. 8 lists b_τ2 twice, the third is b_τ3; the text on Fig. 6 says that panel (a)
has the larger λ, its caption gives (a) 10⁸ and (b) 10⁹.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.settings import Settings

# --- Images -----------------------------------------------------------------------------------


def derivatives(
    frame0: np.ndarray, frame1: np.ndarray, scheme: str, halo: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (I_x, I_y, I_t), each (H + 2·halo, W + 2·halo); images repeat beyond their border.

    ``"cube"``: Horn and Schunck's 2×2×2 cube. ``"five_tap"``: (1, −8, 0, 8, −1)/12 on the mean of
    both frames, and their difference.
    """
    height, width = frame0.shape[0] + 2 * halo, frame0.shape[1] + 2 * halo
    a = np.pad(np.asarray(frame0, np.float64), 2 + halo, mode="edge")
    b = np.pad(np.asarray(frame1, np.float64), 2 + halo, mode="edge")

    def at(image: np.ndarray, dy: int, dx: int) -> np.ndarray:
        return image[2 + dy : 2 + dy + height, 2 + dx : 2 + dx + width]

    if scheme == "five_tap":
        mean = (a + b) / 2
        ix = (at(mean, 0, -2) - 8 * at(mean, 0, -1) + 8 * at(mean, 0, 1) - at(mean, 0, 2)) / 12
        iy = (at(mean, -2, 0) - 8 * at(mean, -1, 0) + 8 * at(mean, 1, 0) - at(mean, 2, 0)) / 12
        return ix, iy, at(b, 0, 0) - at(a, 0, 0)
    both, step = a + b, b - a
    ix = (at(both, 0, 1) + at(both, 1, 1) - at(both, 0, 0) - at(both, 1, 0)) / 4
    iy = (at(both, 1, 0) + at(both, 1, 1) - at(both, 0, 0) - at(both, 0, 1)) / 4
    it = (at(step, 0, 0) + at(step, 0, 1) + at(step, 1, 0) + at(step, 1, 1)) / 4
    return ix, iy, it


def warp(image: np.ndarray, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sample an image at x + flow by Keys' bicubic convolution (a = −½).

    Parameters
    ----------
    image : (H, W)
    flow : (2, H, W)
        px/frame.

    Returns
    -------
    warped, mask : (H, W)
        The mask is 1 where the target lies inside the image.
    """
    height, width = image.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    x, y = columns + flow[0], rows + flow[1]
    mask = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = np.clip(x, -2, width + 1), np.clip(y, -2, height + 1)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    warped = np.zeros((height, width))
    for i in range(-1, 3):
        for j in range(-1, 3):
            weight = _keys(x - (left + i)) * _keys(y - (top + j))
            tap = image[np.clip(top + j, 0, height - 1), np.clip(left + i, 0, width - 1)]
            warped += weight * tap
    return warped, mask.astype(np.float64)


def _keys(distance: np.ndarray) -> np.ndarray:
    d = np.abs(distance)
    near = 1.5 * d**3 - 2.5 * d**2 + 1
    far = -0.5 * d**3 + 2.5 * d**2 - 4 * d + 2
    return np.where(d <= 1, near, np.where(d < 2, far, 0.0))


# --- Model ------------------------------------------------------------------------------------


def motion_matrix(camera: Camera, height: int, width: int, components: int) -> np.ndarray:
    """Return G, (2, components, H, W): eq. 2 in scaled unknowns.

    6 components are rigid motion, 3 translation, 2 the image motion itself.
    """
    cx, cy = camera.center_for(height, width)
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    x, y = (columns - cx) / camera.focal, (rows - cy) / camera.focal
    one, zero = np.ones_like(x), np.zeros_like(x)
    rigid = np.array(
        [
            [one, zero, -x, -x * y, 1 + x * x, -y],
            [zero, one, -y, -(1 + y * y), x * y, x],
        ]
    )
    return rigid[:, :components]


def flow(motion: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Return (u, v), (2, H, W): eq. 25, Gρ̂."""
    return np.einsum("ckyx,kyx->cyx", motion, rho)


def brightness_tensor(
    gradients: tuple[np.ndarray, np.ndarray, np.ndarray],
    flow0: np.ndarray,
    mask: np.ndarray,
) -> np.ndarray:
    """Return J11, J12, J22, j1, j2, J_tt, (6, H, W): eq. 3 squared, in the whole flow.

    `flow0`, (2, H, W), is the flow that the gradients' frame 1 was warped by.
    """
    ix, iy, it = gradients
    c = it - ix * flow0[0] - iy * flow0[1]
    return mask * np.array([ix * ix, ix * iy, iy * iy, c * ix, c * iy, c * c])


def constancy_tensors(
    gradients: tuple[np.ndarray, np.ndarray, np.ndarray],
    flow0: np.ndarray,
    mask: np.ndarray,
    *,
    brightness: float,
    gradient: float,
    normalization: float | None,
) -> list[np.ndarray]:
    """Return the tensors, (6, H, W), of brightness and gradient constancy whose weight is not 0.

    `gradients` have a halo of 2 px. Normalised, each constraint is divided by |∇I|² + ζ².
    """

    def constraint(ix: np.ndarray, iy: np.ndarray, it: np.ndarray) -> np.ndarray:
        tensor = brightness_tensor((ix, iy, it), flow0, mask)
        if normalization is None:
            return tensor
        return tensor / (ix**2 + iy**2 + normalization**2 + 1e-12)

    ix, iy, it = gradients
    terms = []
    if brightness > 0:
        inner = np.s_[2:-2, 2:-2]
        terms.append(brightness * constraint(ix[inner], iy[inner], it[inner]))
    if gradient > 0:
        of_x = constraint(_five_tap(ix, 1), _five_tap(iy, 1), _five_tap(it, 1))
        of_y = constraint(_five_tap(iy, 1), _five_tap(iy, 0), _five_tap(it, 0))
        terms.append(gradient * (of_x + of_y))
    return terms


def _five_tap(image: np.ndarray, axis: int) -> np.ndarray:
    """Return the derivative along an axis by (1, −8, 0, 8, −1)/12, without the halo of 2 px."""
    near = np.roll(image, -1, axis) - np.roll(image, 1, axis)
    far = np.roll(image, -2, axis) - np.roll(image, 2, axis)
    return (8 * near - far)[2:-2, 2:-2] / 12


def robust_tensor(
    terms: Sequence[np.ndarray], motion: np.ndarray, rho: np.ndarray, scales: Sequence[float]
) -> np.ndarray:
    """Return Σ w J, (6, H, W), with w = 1/√(1 + q/s), q the quadratic form and s the scale of J.

    Its J_tt includes the penalty s(w + 1/w − 2), so that its quadratic form is the half-quadratic
    data term.
    """
    total = np.zeros_like(terms[0])
    for term, scale in zip(terms, scales, strict=True):
        weight = 1 / np.sqrt(1 + residual(term, motion, rho) / scale)
        total += weight * term
        if np.isfinite(scale):
            total[5] += scale * (1 - weight) ** 2 / weight
    return total


def robust_energy(
    terms: Sequence[np.ndarray], motion: np.ndarray, rho: np.ndarray, scales: Sequence[float]
) -> float:
    """Return Σ 2s(√(1 + q/s) − 1) over pixels and terms (Charbonnier)."""
    total = 0.0
    for term, scale in zip(terms, scales, strict=True):
        q = residual(term, motion, rho)
        total += float((2 * q / (1 + np.sqrt(1 + q / scale))).sum())
    return total


def residual(tensor: np.ndarray, motion: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Return (u,v) J (u,v)ᵀ + 2 jᵀ(u,v) + J_tt, (H, W): a square, so at least 0."""
    u, v = flow(motion, rho)
    j11, j12, j22, j1, j2, jtt = tensor
    q = j11 * u * u + 2 * j12 * u * v + j22 * v * v + 2 * (j1 * u + j2 * v) + jtt
    return np.maximum(q, 0)


# --- Half-quadratic algorithm -----------------------------------------------------------------


def aubert(difference: np.ndarray, contrast: float) -> np.ndarray:
    """Return Φ_δ(s) = 2δ²(√(1 + s²/δ²) − 1), written without its cancellation."""
    square = difference**2
    return 2 * square / (1 + np.sqrt(1 + square / contrast**2))


def differences(rho: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the eastern and southern differences (eq. 13), (n, H, W), 0 across the border."""
    east, south = np.zeros_like(rho), np.zeros_like(rho)
    east[:, :, :-1] = np.diff(rho, axis=2)
    south[:, :-1] = np.diff(rho, axis=1)
    return east, south


@dataclass(frozen=True, kw_only=True)
class Smoothness:
    """Which differences count as edges, and how much.

    Attributes
    ----------
    contrast : float
        δ, px/frame.
    stiffness : (n,) array or None
        s_k; None for 1.
    joint : bool
        Whether an edge is one for all components.
    edges : (2, H, W) array or None
        g of the eastern and southern edges; None for 1.
    """

    contrast: float
    stiffness: np.ndarray | None = None
    joint: bool = False
    edges: np.ndarray | None = None

    def squares(self, rho: np.ndarray) -> np.ndarray:
        """Return s_kΔ², or, joint, their sum over k for every k: (2, n, H, W)."""
        squares = np.stack(differences(rho)) ** 2 * self.stiffnesses(len(rho))
        if self.joint:
            squares = np.broadcast_to(squares.sum(axis=1, keepdims=True), squares.shape)
        return squares

    def stiffnesses(self, components: int) -> np.ndarray:
        """Return s_k, (n, 1, 1)."""
        values = np.ones(components) if self.stiffness is None else np.asarray(self.stiffness)
        return values[:, None, None]

    def open(self, height: int, width: int) -> np.ndarray:
        """Return g, 0 across the border: (2, 1, H, W)."""
        edges = np.ones((2, height, width)) if self.edges is None else self.edges.copy()
        edges[0, :, -1] = edges[1, -1] = 0
        return edges[:, None]


def image_edges(frame: np.ndarray, strength: float) -> np.ndarray:
    """Return g = c/(1 + κ|ΔI|/m), (2, H, W): m the mean of |ΔI|, c such that the mean of g is 1."""
    steps = np.abs(np.stack(differences(frame[None].astype(np.float64))))[:, 0]
    inside = np.ones(steps.shape, bool)
    inside[0, :, -1] = inside[1, -1] = False
    if not inside.any():
        return np.zeros(steps.shape)
    edges = inside / (1 + strength * steps / max(steps[inside].mean(), 1e-5))
    return edges / edges[inside].mean()


def edge_weights(rho: np.ndarray, smoothness: Smoothness) -> np.ndarray:
    """Return s_k g b (eq. 10, 14), (2n, H, W): n eastern edges, n southern ones."""
    b = 1 / np.sqrt(1 + smoothness.squares(rho) / smoothness.contrast**2)
    weights = smoothness.stiffnesses(len(rho)) * smoothness.open(*rho.shape[1:]) * b
    return weights.reshape(-1, *rho.shape[1:])


def smoothness_energy(rho: np.ndarray, smoothness: Smoothness) -> float:
    """Return Σ_edges g Σ_k Φ_δ(√s_k Δρ̂_k), or, joint, g Φ_δ of the vector's length."""
    penalty = aubert(np.sqrt(smoothness.squares(rho)), smoothness.contrast)
    if smoothness.joint:
        penalty = penalty[:, :1]
    return float((smoothness.open(*rho.shape[1:]) * penalty).sum())


def energy(
    tensor: np.ndarray, motion: np.ndarray, rho: np.ndarray, alpha: float, smoothness: Smoothness
) -> float:
    """Return the energy (eq. 6, 20) of a quadratic data term: that term plus α times smoothness."""
    return data_energy(tensor, motion, rho) + alpha * smoothness_energy(rho, smoothness)


def half_quadratic_energy(
    tensor: np.ndarray,
    motion: np.ndarray,
    rho: np.ndarray,
    weights: np.ndarray,
    alpha: float,
    smoothness: Smoothness,
) -> float:
    """Return its half-quadratic form (eq. 8, 21): per edge g[bΔ² + δ²(b + 1/b − 2)]."""
    n, height, width = rho.shape
    edges = smoothness.open(height, width)
    scale = smoothness.stiffnesses(n) * edges
    b = np.where(scale > 0, weights.reshape(2, n, height, width) / np.where(scale > 0, scale, 1), 1)
    penalty = b * smoothness.squares(rho)
    if np.isfinite(smoothness.contrast):
        penalty = penalty + smoothness.contrast**2 * (1 - b) ** 2 / b
    if smoothness.joint:
        penalty = penalty[:, :1]
    return data_energy(tensor, motion, rho) + alpha * float((edges * penalty).sum())


def data_energy(tensor: np.ndarray, motion: np.ndarray, rho: np.ndarray) -> float:
    """Return Σ (u,v) J (u,v)ᵀ + 2 jᵀ(u,v) + J_tt."""
    u, v = flow(motion, rho)
    j11, j12, j22, j1, j2, jtt = tensor
    return float((j11 * u * u + 2 * j12 * u * v + j22 * v * v + 2 * (j1 * u + j2 * v) + jtt).sum())


def local_matrices(
    tensor: np.ndarray, motion: np.ndarray, weights: np.ndarray, alpha: float
) -> np.ndarray:
    """Return B, (H, W, n, n), of Bρ̂ = c (eq. 16, 22–23) at every pixel."""
    n = motion.shape[1]
    j11, j12, j22, *_ = tensor
    total = np.sum(_neighbour_weights(weights), axis=0)  # b̄, eq. 17
    j_motion = np.stack([j11 * motion[0] + j12 * motion[1], j12 * motion[0] + j22 * motion[1]])
    matrix = np.einsum("ckyx,clyx->yxkl", motion, j_motion)
    matrix[..., range(n), range(n)] += alpha * np.moveaxis(total, 0, -1)
    return matrix


def local_right_sides(
    tensor: np.ndarray, motion: np.ndarray, weights: np.ndarray, rho: np.ndarray, alpha: float
) -> np.ndarray:
    """Return c, (H, W, n), of Bρ̂ = c at every pixel."""
    north, south, east, west = _neighbour_weights(weights)
    neighbours = np.zeros_like(rho)  # Σ b_N ρ̂_N, eq. 17
    neighbours[:, 1:] += north[:, 1:] * rho[:, :-1]
    neighbours[:, :-1] += south[:, :-1] * rho[:, 1:]
    neighbours[:, :, :-1] += east[:, :, :-1] * rho[:, :, 1:]
    neighbours[:, :, 1:] += west[:, :, 1:] * rho[:, :, :-1]
    right = alpha * neighbours - motion[0] * tensor[3] - motion[1] * tensor[4]
    return np.moveaxis(right, 0, -1)


def _neighbour_weights(
    weights: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return b to the north, south, east and west of every pixel, each (n, H, W)."""
    n = len(weights) // 2
    east, south = weights[:n], weights[n:]
    north, west = np.zeros_like(south), np.zeros_like(east)
    north[:, 1:] = south[:, :-1]
    west[:, :, 1:] = east[:, :, :-1]
    return north, south, east, west


def sweep_lexicographic(
    tensor: np.ndarray,
    motion: np.ndarray,
    weights: np.ndarray,
    rho: np.ndarray,
    *,
    alpha: float,
    relaxation: float = 1.0,
) -> None:
    """Gauss–Seidel in reading order, one pixel at a time; `rho` is modified in place."""
    n, height, width = rho.shape
    j11, j12, j22, j1, j2, _ = tensor
    east, south = weights[:n], weights[n:]
    for y in range(height):
        for x in range(width):
            g = motion[:, :, y, x]
            tensor_here = np.array([[j11[y, x], j12[y, x]], [j12[y, x], j22[y, x]]])
            right = -g.T @ np.array([j1[y, x], j2[y, x]])
            total = np.zeros(n)
            for edge, inside, ny, nx in (
                (east[:, y, x], x + 1 < width, y, x + 1),
                (east[:, y, x - 1], x > 0, y, x - 1),
                (south[:, y, x], y + 1 < height, y + 1, x),
                (south[:, y - 1, x], y > 0, y - 1, x),
            ):
                if inside:
                    total += edge
                    right += alpha * edge * rho[:, ny, nx]
            matrix = g.T @ tensor_here @ g + alpha * np.diag(total)
            rho[:, y, x] += relaxation * (np.linalg.solve(matrix, right) - rho[:, y, x])


def sweep_red_black(
    tensor: np.ndarray,
    motion: np.ndarray,
    weights: np.ndarray,
    rho: np.ndarray,
    *,
    alpha: float,
    relaxation: float = 1.0,
) -> None:
    """Gauss–Seidel over the red pixels at once, then the black; `rho` is modified in place.

    Red pixels have an even sum of row and column.
    """
    rows, columns = np.indices(rho.shape[1:])
    matrix = local_matrices(tensor, motion, weights, alpha)
    for color in (0, 1):
        sites = (rows + columns) % 2 == color
        right = local_right_sides(tensor, motion, weights, rho, alpha)
        solution = np.linalg.solve(matrix[sites], right[sites][..., None])[..., 0].T
        rho[:, sites] += relaxation * (solution - rho[:, sites])


@dataclass(frozen=True)
class Minimisation:
    """Energies and relative changes of the half-quadratic iterations."""

    energies: list[float]
    half_quadratic: list[float]
    changes: list[float]
    converged: bool


def minimise(
    terms: Sequence[np.ndarray],
    motion: np.ndarray,
    rho: np.ndarray,
    *,
    alpha: float,
    smoothness: Smoothness,
    outer_iterations: int,
    sweeps: int,
    scales: Sequence[float] = (np.inf,),
    relaxation: float = 1.0,
    tolerance: float = 0.0,
) -> Minimisation:
    """Run the half-quadratic algorithm (Table 1); `rho` is modified in place.

    `terms` are motion tensors, (6, H, W), with the scales of `robust_tensor`.
    """
    energies: list[float] = []
    half: list[float] = []
    changes: list[float] = []
    for _ in range(outer_iterations):
        before = rho.copy()
        weights = edge_weights(rho, smoothness)
        tensor = robust_tensor(terms, motion, rho, scales)
        for _ in range(sweeps):
            sweep_red_black(tensor, motion, weights, rho, alpha=alpha, relaxation=relaxation)
        data = robust_energy(terms, motion, rho, scales)
        energies.append(data + alpha * smoothness_energy(rho, smoothness))
        half.append(half_quadratic_energy(tensor, motion, rho, weights, alpha, smoothness))
        moved, size = np.linalg.norm(rho - before), np.linalg.norm(rho)
        changes.append(float(moved / size) if size > 0 else 0.0)
        if moved <= tolerance * size:
            return Minimisation(energies, half, changes, True)
    return Minimisation(energies, half, changes, False)


# --- Coarse to fine ---------------------------------------------------------------------------


def prolong(coarse: np.ndarray, shape: tuple[int, int], ratio: float) -> np.ndarray:
    """Return ρ̂ of a coarser level, (n, h, w), on a finer grid of `shape`, bilinearly.

    Pixel x of the fine grid lies at (x + ½)·ratio − ½ on the coarse one, and ρ̂, in pixels of its
    level, is divided by `ratio`.
    """

    def positions(count: int, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = np.clip((np.arange(count) + 0.5) * ratio - 0.5, 0, size - 1)
        first = np.minimum(x.astype(int), max(size - 2, 0))
        return first, np.minimum(first + 1, size - 1), x - first

    top, bottom, down = positions(shape[0], coarse.shape[1])
    left, right, across = positions(shape[1], coarse.shape[2])
    columns = coarse[:, :, left] * (1 - across) + coarse[:, :, right] * across
    down = down[:, None]
    return (columns[:, top] * (1 - down) + columns[:, bottom] * down) / ratio


def coarse_to_fine(
    pyramid0: list[np.ndarray], pyramid1: list[np.ndarray], camera: Camera, settings: Settings
) -> np.ndarray:
    """Return ρ̂, (n, H, W), of the finest of the given levels, the finest first.

    `camera` is that of the finest level; of the settings, the pyramid is the one given.
    """
    n, factor = settings.components, settings.pyramid_factor
    height, width = pyramid0[0].shape
    epsilon = np.inf if settings.data_contrast is None else settings.data_contrast
    scales = [m * epsilon**2 for m in (settings.brightness, settings.gradient) if m > 0]
    rho: np.ndarray | None = None
    for level in reversed(range(len(pyramid0))):
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
        outer_iterations, tolerance = settings.iterations_at(level)
        for _ in range(settings.warps):
            flow0 = flow(motion, rho)
            warped, mask = warp(frame1, flow0)
            gradients = derivatives(frame0, warped, settings.derivatives, halo=2)
            minimise(
                constancy_tensors(
                    gradients,
                    flow0,
                    mask,
                    brightness=settings.brightness,
                    gradient=settings.gradient,
                    normalization=settings.normalization,
                ),
                motion,
                rho,
                alpha=settings.alpha,
                smoothness=smoothness,
                scales=scales,
                outer_iterations=outer_iterations,
                sweeps=settings.sweeps,
                relaxation=settings.relaxation,
                tolerance=tolerance,
            )
    if rho is None:
        raise ValueError("pyramids are empty: expected at least one level")
    return rho
