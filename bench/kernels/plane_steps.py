"""Kernels and references of planes matched by correlation, in one or several frames."""

from functools import cached_property, partial

import numpy as np

from bench import reference
from bench.kernels.sides import NumpySide, Run, TaichiSide, Timed
from bench.kernels.traffic import VIEWS
from bench.shared.problems import UNCERTAIN_BORDER, Problem, in_single_precision
from tisfm.kernels.rigid.foreground_fattening import find_fattened
from tisfm.kernels.rigid.patch_match import MAX_SLOPE, PlaneSearch, plane_disagreement
from tisfm.kernels.rigid.view_search import MISSING_FRAME_COST, ViewSearch
from tisfm.kernels.rigid.weighted_median import weighted_median
from tisfm.kernels.rigid.windows import MAX_GREY, UNTEXTURED

NOISE = 1.5  # grey levels, deviation of the noise
MIN_WINDOW_VARIANCE = 1.8  # minimum variance of a textured window, in variances of the noise
BOUNDS = 0.01, 10.0  # px/frame, of searched inverse depths
SPREAD = 0.5  # px/frame, of drawn inverse depths
TILT = 0.02  # px/frame per px, of drawn slopes
DRAWS = 2  # planes that are drawn per pixel
BEST_FRAMES = 1  # number of best frames whose mean cost counts
PLANE = (0.03, -0.02)  # slopes of the only plane of frame 1

FATTENING = {
    "contour_distance": 5,
    "surface_distance": 12,
    "contrast": 3.0,
    "min_contrast": 4.5,
    "min_step": 0.07,
    "max_difference": 0.04,
}
MEDIAN = {"radius": 3, "grey_scale": 5.0, "same_share": 0.02, "max_own_weight": 0.4}


class Planes:
    """Planes near the true ones, and the frames as bytes.

    Frame 1 has a single plane, so every pixel of it gives the same answer. `motion`, (3, 4), is R
    and t from frame 0 to frame 1.
    """

    def __init__(self, problem: Problem, motion: np.ndarray) -> None:
        rng, size = np.random.default_rng(6), (problem.height, problem.width)
        self.levels = [np.rint(np.clip(frame, 0, MAX_GREY)) for frame in problem.frames]
        slopes = 0.02 * rng.normal(size=(2, *size))
        self.start_planes = in_single_precision(np.concatenate([problem.inverse_depth, slopes]))
        rows, columns = np.indices(size)
        depth = self.start_planes[0].mean() + PLANE[0] * columns + PLANE[1] * rows
        self.planes1 = in_single_precision(np.stack(np.broadcast_arrays(depth, *PLANE)))
        self.camera = problem.camera
        self.pose = motion[:, :3], motion[:, 3]
        u, v = reference.displacement(self.start_planes[0], self.camera, *self.pose)
        x, y = columns + u, rows + v
        border_distance = [x, x + 1 - problem.width, y, y + 1 - problem.height]
        # Pixels clearly inside or outside the image; for others rounding decides.
        self.certain = (np.abs(np.abs(border_distance) - 0.5) > UNCERTAIN_BORDER).all(axis=0)

    def cost(self, planes: np.ndarray) -> np.ndarray:
        """Return the cost of planes, (3, H, W), `UNTEXTURED` for windows without texture."""
        cost, variance = reference.plane_cost(
            *self.levels, planes, self.camera, *self.pose, noise=NOISE**2
        )
        return np.where(variance > MIN_WINDOW_VARIANCE * NOISE**2, cost, UNTEXTURED)

    def outlined(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return frame, inverse depth and matches, (H, W) each, with outlines every 8 columns."""
        depth, steps = self.start_planes[0], np.arange(self.levels[0].shape[1]) // 8 % 2
        outlined_depth = in_single_precision(np.abs(depth) * (1 + 0.5 * steps))
        return self.levels[0] + 100 * steps, outlined_depth, np.roll(outlined_depth, 3, axis=1)

    def stepped(self) -> tuple[np.ndarray, np.ndarray]:
        """Return frame and inverse depth, (H, W) each, that is so coarse that medians are exact."""
        frame, depth, _ = self.outlined()
        return frame, np.rint(depth)


def search_options(p: Problem) -> dict:
    """Return the common options of searches in one frame and in several frames."""
    center = p.camera.center_for(p.height, p.width)
    options = {
        "noise": NOISE,
        "min_variance": MIN_WINDOW_VARIANCE,
        "min_depth": BOUNDS[0],
        "max_depth": BOUNDS[1],
    }
    return {"center": center, "focal": p.camera.focal, **options}


def interleaved(planes: np.ndarray) -> np.ndarray:
    """Return planes, (3, H, W), in the layout of the kernels without costs: (H, W, 4) float32."""
    state = np.zeros((*planes.shape[1:], 4), np.float32)
    state[..., :3] = np.moveaxis(planes, 0, -1)
    return state


def _finite_difference(difference: np.ndarray, certain: np.ndarray) -> np.ndarray:
    """Return a disagreement, -1 if infinite, at the certain pixels, (1, H, W)."""
    return np.where(np.isfinite(difference), difference, -1)[None] * certain


def summary(cost: np.ndarray) -> np.ndarray:
    """Return the quartiles of costs, (3, 1).

    Rounding may decide between two planes of a pixel, which changes quartiles little.
    """
    return np.quantile(cost, [0.25, 0.5, 0.75])[:, None]


class Views:
    """Planes near the true ones, and frame 1 under several motions."""

    def __init__(self, problem: Problem) -> None:
        self.motions = problem.motions[:VIEWS]
        self._planes_of_views = [Planes(problem, motion) for motion in self.motions]
        self.planes = self._planes_of_views[0]
        self.start_planes = self.planes.start_planes
        self.certain = np.logical_and.reduce([planes.certain for planes in self._planes_of_views])
        # The kernel also computes costs of bare windows, which the reference skips.
        self.is_compared = self.certain & (self.costs(self.start_planes)[0] < UNTEXTURED)

    def costs(self, planes: np.ndarray) -> np.ndarray:
        """Return the costs of planes, (3, H, W), under each motion, as `Planes.cost`."""
        return np.array([view.cost(planes) for view in self._planes_of_views])

    def cost(self, planes: np.ndarray) -> np.ndarray:
        """Return the cost of planes in the best frames."""
        return reference.best_mean(self.costs(planes), BEST_FRAMES, missing_cost=MISSING_FRAME_COST)


Surface = Planes | Views


def time_score(search: PlaneSearch | ViewSearch, surface: Surface) -> Timed:
    state = interleaved(surface.start_planes)
    return partial(search.score, state), lambda _: (state[..., 3] * surface.certain)[None]


def time_improve(search: PlaneSearch | ViewSearch, surface: Surface) -> Timed:
    state = interleaved(surface.start_planes)
    search.score(state)
    options = {"draws": DRAWS, "spread": SPREAD, "tilt": TILT, "seed": 0}
    return partial(search.improve, state, **options), lambda _: summary(state[..., 3])


def reference_score(surface: Surface) -> Run:
    return lambda: (surface.cost(surface.start_planes) * surface.certain)[None]


def reference_improve(surface: Surface, focal: float) -> Run:
    state = np.concatenate([surface.start_planes, surface.cost(surface.start_planes)[None]])
    options = {"spread": SPREAD, "tilt": TILT, "max_slope": MAX_SLOPE / focal, "bounds": BOUNDS}

    def run() -> np.ndarray:
        nonlocal state
        for color in range(2):
            state = reference.improve_planes(
                state, surface.cost, color=color, draws=DRAWS, seed=color, **options
            )
        return summary(state[3])

    return run


class PlaneOperations(TaichiSide):
    @cached_property
    def planes(self) -> Planes:
        return Planes(self.problem, self.problem.motions[0])

    @cached_property
    def views(self) -> Views:
        return Views(self.problem)

    def score(self) -> Timed:
        return time_score(self._search(), self.planes)

    def improve(self) -> Timed:
        return time_improve(self._search(), self.planes)

    def plane_disagreement(self) -> Timed:
        p, planes = self.problem, self.planes
        arrays = [interleaved(array) for array in (planes.start_planes, planes.planes1)]
        out = np.empty((p.height, p.width), np.float32)
        options = {"center": p.camera.center_for(p.height, p.width), "focal": p.camera.focal}
        return (
            partial(plane_disagreement, *arrays, p.motions[0], out, **options),
            lambda _: _finite_difference(out, planes.certain),
        )

    def views_score(self) -> Timed:
        return time_score(self._views_search(), self.views)

    def views_improve(self) -> Timed:
        return time_improve(self._views_search(), self.views)

    def views_costs(self) -> Timed:
        p, search, state = self.problem, self._views_search(), interleaved(self.views.start_planes)
        out = np.empty((VIEWS, p.height, p.width), np.float32)
        return partial(search.write_costs, state, out), lambda _: out * self.views.is_compared

    def find_fattened(self) -> Timed:
        arrays = [np.ascontiguousarray(a, np.float32) for a in self.planes.outlined()]
        out = np.empty(arrays[0].shape, np.int32)
        return partial(find_fattened, *arrays, out, **FATTENING), lambda _: out[None].astype(float)

    def weighted_median(self) -> Timed:
        frame, depth = (np.ascontiguousarray(a, np.float32) for a in self.planes.stepped())
        everywhere, out = np.ones(frame.shape, np.int32), np.empty_like(frame)
        arrays = depth, frame, everywhere, everywhere, out
        return partial(weighted_median, *arrays, **MEDIAN), lambda _: out[None]

    def _search(self) -> PlaneSearch:
        p, levels = self.problem, [part.astype(np.float32) for part in self.planes.levels]
        return PlaneSearch(*levels, p.motions[0], **search_options(p))

    def _views_search(self) -> ViewSearch:
        p, levels = self.problem, [part.astype(np.float32) for part in self.views.planes.levels]
        others = [levels[1]] * VIEWS
        options = {"frame_count": BEST_FRAMES, "stride": 1, **search_options(p)}
        return ViewSearch(levels[0], others, self.views.motions, **options)


class PlaneReferences(NumpySide):
    @cached_property
    def planes(self) -> Planes:
        return Planes(self.problem, self.problem.motions[0])

    @cached_property
    def views(self) -> Views:
        return Views(self.problem)

    def score(self) -> Run:
        return reference_score(self.planes)

    def improve(self) -> Run:
        return reference_improve(self.planes, self.problem.camera.focal)

    def plane_disagreement(self) -> Run:
        planes = self.planes
        arguments = planes.start_planes, planes.planes1, planes.camera, *planes.pose
        return lambda: _finite_difference(reference.plane_disagreement(*arguments), planes.certain)

    def find_fattened(self) -> Run:
        arrays = self.planes.outlined()
        return lambda: reference.find_fattened(*arrays, **FATTENING)[None].astype(float)

    def weighted_median(self) -> Run:
        frame, depth = self.planes.stepped()
        arrays = depth, frame, *[np.ones(frame.shape, bool)] * 2
        return lambda: reference.weighted_median(*arrays, **MEDIAN)[None]

    def views_score(self) -> Run:
        return reference_score(self.views)

    def views_improve(self) -> Run:
        return reference_improve(self.views, self.problem.camera.focal)

    def views_costs(self) -> Run:
        views = self.views
        return lambda: views.costs(views.start_planes) * views.is_compared
