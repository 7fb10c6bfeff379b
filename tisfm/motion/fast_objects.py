"""Things that move far for their size, kept apart from what is around them.

The smoothness of a flow charges for every step of motion along an outline, without bound, so that
a small thing that moves far is cheaper moved with its surroundings, whatever the images say. Once
the images have said it, the smoothness is cut along the outline, and the outline itself is found
anew on every level, by the images alone.
"""

from collections.abc import Iterator

import cv2
import numpy as np

from tisfm.kernels.data.image_edges import image_edges
from tisfm.kernels.layout.images import image_to_lanes
from tisfm.kernels.rigid.flow_search import carry
from tisfm.motion.matched_windows import Windows
from tisfm.motion.residual_comparison import ResidualComparison
from tisfm.solver.coarse_to_fine import Problem
from tisfm.solver.smoothness import FAINTEST_EDGE, mean_step
from tisfm.solver.unknowns import Unknowns

BEYOND, WITHIN = 5, 2  # px to either side of an outline: it is somewhere there
WINDOW = 3  # px: the side of the square that tells to which side a pixel belongs
TURNS = 3  # of finding an outline from the one before
PASSES = 2  # of carrying, along rows and columns
LIFTED = 1e6  # mean steps of the frame by which things are lifted: no smoothness crosses that
MARGIN = 3  # px: as far as differences and means look
AROUND = TURNS * BEYOND + MARGIN  # px around a thing: as far as its outline may be found

Part = tuple[slice, slice]  # rows and columns


class FastObjects:
    """Where things are that move on their own.

    Parameters
    ----------
    thing : (h, w) bool
        The pixels of things, on any level.
    problem : Problem
    """

    def __init__(self, thing: np.ndarray, problem: Problem) -> None:
        self._thing, self._problem = thing, problem

    def set_apart(self, windows: Windows, unknowns: Unknowns) -> None:
        """Find the outlines on a level, and cut the smoothness there.

        Parameters
        ----------
        windows : Windows
            Of that level.
        unknowns : Unknowns
            ρ̂ near the outlines is overwritten, and so are their `edges`.
        """
        self._thing = _enlarged(self._thing, windows.shape)
        self._outline(windows, unknowns)
        step = max(mean_step(windows.levels0, windows.counted0), FAINTEST_EDGE)
        lifted = windows.levels0.copy()
        lifted[self._thing] += np.float32(LIFTED * step)
        rate = self._problem.smoothness.image_edges / step
        image_edges(unknowns.grid, lifted, unknowns.edges, rate=rate)

    def _outline(self, windows: Windows, unknowns: Unknowns) -> None:
        """Find the outlines, each in its part of the image, and overwrite ρ̂ near them."""
        flow, changes = unknowns.flow(), []
        for part, own in _parts(self._thing, flow):
            before = better = cv2.merge(list(flow[:, part[0], part[1]]))
            thing = self._thing[part] & own
            evidence = ResidualComparison(windows.part(part), self._problem.constancy)
            for _ in range(TURNS):
                thing, better = _outlined(evidence, thing, better)
            self._thing[part] = np.where(own, thing, self._thing[part])
            changes.append((part, np.where(own[..., None], better - before, 0)))
        del flow
        for component in range(2):
            rho = unknowns.to_image(unknowns.rho, component)
            for part, change in changes:
                rho[part] += change[..., component]
            image_to_lanes(unknowns.grid, rho, unknowns.rho, component=component)


def _enlarged(thing: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the pixels of things on a finer level, or a copy of those on the same."""
    if thing.shape == shape:
        return thing.copy()
    size = shape[::-1]
    return cv2.resize(thing.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5


def _parts(thing: np.ndarray, flow: np.ndarray) -> Iterator[tuple[Part, np.ndarray]]:
    """Yield, for each thing, the part of the image it crosses, and the pixels that are its own.

    Its own are the pixels around it, (h, w) bool of that part, to which no other thing is as near.
    """
    around = cv2.dilate(thing.astype(np.uint8), _square(AROUND))
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(around, connectivity=8)
    for label in range(1, count):
        left, top, width, height, _ = boxes[label]
        u, v = flow[:, top : top + height, left : left + width]
        part = (
            _reached(top, top + height, v, thing.shape[0]),
            _reached(left, left + width, u, thing.shape[1]),
        )
        yield part, labels[part] == label


def _reached(first: int, end: int, motion: np.ndarray, length: int) -> slice:
    """Return where pixels from the first to the end are, and where motions along the axis go."""
    least, most = first + motion.min() - MARGIN, end + motion.max() + MARGIN
    first, end = (int(np.clip(place, 0, length)) for place in (min(first, least), max(end, most)))
    return slice(first, end)


def _outlined(
    evidence: ResidualComparison, thing: np.ndarray, flow: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return which pixels are of a thing, from what they seemed to be, and the flow of that."""
    seeming = thing.astype(np.uint8)
    wide = cv2.dilate(seeming, _square(BEYOND)) > 0
    core = cv2.erode(seeming, _square(WITHIN)) > 0
    inside, outside = _carried(flow, core), _carried(flow, ~wide)
    found = core | (wide & evidence.better(inside, outside, window=WINDOW))
    _, labels = cv2.connectedComponents(found.astype(np.uint8), connectivity=4)
    found = np.isin(labels, np.unique(labels[core]))  # without what has come off
    better = np.where(found[..., None], inside, outside)
    return found, np.where(wide[..., None], better, flow)


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def _carried(flow: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return a flow carried from where it is known to the nearest pixels elsewhere."""
    distance = np.where(known, 0, np.float32(known.size)).astype(np.float32)
    state = np.zeros((*known.shape, 4), np.float32)
    state[..., :2] = flow
    flat = np.zeros(known.shape, np.float32)
    for _ in range(PASSES):
        carry(flat, distance, state, edge=1.0)
    return state[..., :2].copy()
