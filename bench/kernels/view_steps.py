"""Both sides of the kernels of planes that are matched in several frames."""

from functools import cached_property

import numpy as np

from bench import reference
from bench.kernels.plane_steps import (
    BOUNDS,
    DRAWS,
    NOISE,
    SEEN,
    SPREAD,
    TILT,
    Planes,
    interleaved,
    summary,
)
from bench.kernels.sides import NumpySide, Run, TaichiSide, Timed
from bench.kernels.traffic import VIEWS
from bench.shared.problems import Problem
from tisfm.kernels.rigid.patch_match import STEEPEST
from tisfm.kernels.rigid.view_search import ABSENT, ViewSearch
from tisfm.kernels.rigid.windows import UNSEEN

BEST = 1  # frames that a cost is the mean of


class Views:
    """Planes near the true ones, and frame 1 as if it were seen under several motions."""

    def __init__(self, problem: Problem) -> None:
        self.motions = problem.motions[:VIEWS]
        self._each = [Planes(problem, motion) for motion in self.motions]
        self.planes = self._each[0]
        self.decided = np.logical_and.reduce([planes.decided for planes in self._each])
        # The kernel gives costs of bare windows as well, which the reference calls unseen.
        self.seen = self.decided & (self.costs(self.planes.own)[0] < UNSEEN)

    def costs(self, planes: np.ndarray) -> np.ndarray:
        """Return what planes, (3, H, W), cost under each motion, and `UNSEEN` as `Planes` does."""
        return np.array([each.cost(planes) for each in self._each])

    def cost(self, planes: np.ndarray) -> np.ndarray:
        """Return what they cost in the best of the frames."""
        return reference.best_mean(self.costs(planes), BEST, absent=ABSENT)


class ViewOperations(TaichiSide):
    """The kernels, by their wrappers."""

    @cached_property
    def views(self) -> Views:
        return Views(self.problem)

    def views_score(self) -> Timed:
        state, search = interleaved(self.views.planes.own), self._views_search()
        return lambda: search.score(state), lambda _: (state[..., 3] * self.views.decided)[None]

    def views_improve(self) -> Timed:
        state, search = interleaved(self.views.planes.own), self._views_search()
        search.score(state)
        options = {"draws": DRAWS, "spread": SPREAD, "tilt": TILT, "seed": 0}
        return lambda: search.improve(state, **options), lambda _: summary(state[..., 3])

    def views_costs(self) -> Timed:
        p, search = self.problem, self._views_search()
        state = interleaved(self.views.planes.own)
        out = np.empty((VIEWS, p.height, p.width), np.float32)
        return lambda: search.costs(state, out), lambda _: out * self.views.seen

    def _views_search(self) -> ViewSearch:
        p, levels = self.problem, [part.astype(np.float32) for part in self.views.planes.levels]
        return ViewSearch(
            levels[0],
            [levels[1]] * VIEWS,
            self.views.motions,
            best=BEST,
            stride=1,
            center=p.camera.center_for(p.height, p.width),
            focal=p.camera.focal,
            noise=NOISE,
            seen=SEEN,
            least=BOUNDS[0],
            largest=BOUNDS[1],
        )


class ViewReferences(NumpySide):
    """The same by `bench.reference`."""

    @cached_property
    def views(self) -> Views:
        return Views(self.problem)

    def views_score(self) -> Run:
        views = self.views
        return lambda: (views.cost(views.planes.own) * views.decided)[None]

    def views_improve(self) -> Run:
        views = self.views
        own = views.planes.own
        state = np.concatenate([own, views.cost(own)[None]])
        steepest = STEEPEST / self.problem.camera.focal
        options = {"spread": SPREAD, "tilt": TILT, "steepest": steepest, "bounds": BOUNDS}

        def run() -> np.ndarray:
            nonlocal state
            for color in range(2):
                state = reference.improved_planes(
                    state, views.cost, color=color, draws=DRAWS, seed=color, **options
                )
            return summary(state[3])

        return run

    def views_costs(self) -> Run:
        views = self.views
        return lambda: views.costs(views.planes.own) * views.seen
