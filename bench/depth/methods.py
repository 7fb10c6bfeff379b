"""Methods in the comparison of depth: tisfm, and two stages after a flow."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from numpy.typing import NDArray

import tisfm
from bench.depth.pairs import DepthPair
from bench.depth.two_stage import NoMotion, two_stage
from bench.shared.contest import Method as FlowMethod
from bench.shared.contest import MethodFailure
from tisfm.evaluation.pair_errors import LITTLE_PARALLAX
from tisfm.rigid import pose_matrix
from tisfm.settings import Motion, Preset, Settings

THRESHOLDS = (0.001, 0.002, 0.005, 0.02, 0.1, 0.5)  # px, of the essential matrix


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Result of one call of a method.

    Attributes
    ----------
    method : str
        Name in the tables.
    seconds : float
        Wall time of the whole call.
    threshold : float or None
        Of the essential matrix, px.
    flow_seconds : float or None
        Time of the flow, for a method that starts from one.
    pose : (4, 4) float64 or None
        P₁ = R P₀ + t.
    inverse_depth : (H, W) array or None
        Signed; None if the method reports no depth.
    deviation : (H, W) array or None
        Standard deviation of the inverse depth.
    visible : (H, W) bool array or None
        Pixels that the method reports as visible in frame 1.
    status : str
    failure : str
        The reason if there is no result, else "".
    """

    method: str
    seconds: float
    threshold: float | None = None
    flow_seconds: float | None = None
    pose: NDArray | None = None
    inverse_depth: NDArray | None = None
    deviation: NDArray | None = None
    visible: NDArray | None = None
    status: str = ""
    failure: str = ""


class Method(Protocol):
    """A method in the comparison."""

    @property
    def name(self) -> str:
        """Name in the tables."""

    def run(self, pair: DepthPair) -> Sequence[Estimate]:
        """Return an estimate for each threshold; raise MethodFailure if there is none."""


@dataclass(frozen=True)
class Joint:
    """`tisfm.interpret` with a preset and a motion model."""

    preset: Preset
    motion: Motion

    @property
    def name(self) -> str:
        """The preset and the motion model."""
        return f"tisfm {self.preset}, {self.motion}"

    def run(self, pair: DepthPair) -> Sequence[Estimate]:
        """Interpret a pair."""
        settings = Settings.preset(self.preset, motion=self.motion)
        pose = pair.pose if pair.pose_given else None
        started = time.perf_counter()
        try:
            result = tisfm.interpret(
                pair.frame0, pair.frame1, camera=pair.camera, settings=settings, pose=pose
            )
        except Exception as error:  # a failure must not lose the figures of the other methods
            raise MethodFailure(f"{type(error).__name__}: {error}") from error
        seconds = time.perf_counter() - started
        seen = result.status not in LITTLE_PARALLAX
        found = None if result.motions is None else pose_matrix(result.motions[0])
        return [
            Estimate(
                method=self.name,
                seconds=seconds,
                pose=found,
                inverse_depth=result.inverse_depth if seen else None,
                deviation=result.inverse_depth_std if seen else None,
                visible=~result.occlusion,
                status=str(result.status),
            )
        ]


class FlowThenDepth:
    """A flow, an essential matrix and triangulation.

    Parameters
    ----------
    flow : Method
        Of `bench.shared.contest`: of another library, or of tisfm.
    thresholds : sequence of float
        Of the essential matrix, px; each gives an estimate from the same flow.
    """

    def __init__(self, flow: FlowMethod, thresholds: Sequence[float] = THRESHOLDS) -> None:
        self.flow, self.thresholds = flow, tuple(thresholds)

    @property
    def name(self) -> str:
        """The flow's name and the stages after it."""
        return f"{self.flow.name} + essential matrix"

    def run(self, pair: DepthPair) -> Sequence[Estimate]:
        """Return an estimate for each threshold."""
        call = self.flow.run(pair.flow_pair())
        pose = pair.pose if pair.pose_given else None
        estimates = []
        for threshold in self.thresholds:
            started = time.perf_counter()
            try:
                found = two_stage(call.flow, pair.camera, threshold=threshold, pose=pose)
                failure = ""
            except NoMotion as none:
                found, failure = None, str(none)
            seconds = call.seconds + time.perf_counter() - started
            estimates.append(
                Estimate(
                    method=self.name,
                    seconds=seconds,
                    threshold=threshold,
                    flow_seconds=call.seconds,
                    pose=None if found is None else found.pose,
                    inverse_depth=None if found is None else found.inverse_depth,
                    failure=failure,
                )
            )
        return estimates
