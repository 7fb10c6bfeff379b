"""Things that move farther than they are large, kept apart from what is around them.

The smoothness of a flow charges for every step of motion along an outline, without bound, so that
a small thing that moves far is cheaper moved with its surroundings, whatever the images say. Once
the images have said it, the smoothness is cut along the outline, and the outline itself is found
anew on every level, by the images alone.
"""

import cv2
import numpy as np

from tisfm.kernels.data.image_edges import image_edges
from tisfm.kernels.rigid.flow_search import carry
from tisfm.motion.evidence import Evidence
from tisfm.motion.matched_windows import Windows
from tisfm.solver.coarse_to_fine import Problem
from tisfm.solver.smoothness import FAINTEST_EDGE, mean_step
from tisfm.solver.unknowns import Unknowns

BEYOND, WITHIN = 5, 2  # px to either side of an outline: it is somewhere there
WINDOW = 3  # px: the side of the square that tells to which side a pixel belongs
TURNS = 3  # of finding an outline from the one before
PASSES = 2  # of carrying, along rows and columns
LIFTED = 1e6  # mean steps of the frame by which things are lifted: no smoothness crosses that


class Strays:
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
        flow = better = cv2.merge(list(unknowns.flow()))
        evidence = Evidence(windows, self._problem.constancy)
        for _ in range(TURNS):
            self._thing, better = _told(evidence, self._thing, better)
        rho = unknowns.images()
        rho[:2] += cv2.split(better - flow)
        unknowns.set_images(rho)
        step = max(mean_step(windows.levels0), FAINTEST_EDGE)
        image_edges(
            unknowns.grid,
            windows.levels0 + np.float32(LIFTED * step) * self._thing,
            unknowns.edges,
            rate=self._problem.smoothness.image_edges / step,
        )


def _told(evidence: Evidence, thing: np.ndarray, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which pixels are of things, from what they seemed to be, and a flow that says so."""
    size = flow.shape[1::-1]
    enlarged = cv2.resize(thing.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    seeming = (enlarged > 0.5).astype(np.uint8)
    wide = cv2.dilate(seeming, _square(BEYOND)) > 0
    core = cv2.erode(seeming, _square(WITHIN)) > 0
    inside, outside = _carried(flow, core), _carried(flow, ~wide)
    told = core | (wide & evidence.better(inside, outside, window=WINDOW))
    _, labels = cv2.connectedComponents(told.astype(np.uint8), connectivity=4)
    told = np.isin(labels, np.unique(labels[core]))  # without what has come off
    better = np.where(told[..., None], inside, outside)
    return told, np.where(wide[..., None], better, flow)


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
