"""Evidence for and against a camera path, and its limits."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of the evidence against a path.

    An experiment on 41 paths set them: 19 wrong paths are contradicted, and 22 right ones are not.
    The limits of the zoom were set by hand, with deviations that included `zoom_prior`: right paths
    that grow by more than 0.003 a frame did so by at most 3.4 deviations, and a film that zooms by
    1 % a frame by 4.9.
    """

    max_excess: float = 0.05  # share of the rays
    max_residual_ratio: float = 1.6  # residual of the path divided by that of the free motion
    max_direction: float = 8.0  # degrees
    max_direction_deviations: float = 4.0  # standard deviations of the free direction
    min_rank: float = 0.62  # rank correlation
    max_behind: float = 0.08  # share of the rays
    max_zoom_per_frame: float = 0.003  # logarithm
    min_zoom_significance: float = 4.5  # standard deviations
    zoom_prior: float = 0.03  # standard deviation of the logarithm of the zoom between two frames
    # residual without a zoom over that with it; planes, which any zoom fits, have at most 1.02
    min_zoom_gain: float = 1.03
    max_fixed_share: float = 0.02  # share of the texture
    # relative standard deviation of the focal length: below, the image motion shows it; set by hand
    max_focal_spread: float = 0.1
    focal_prior: float = 0.5  # standard deviation of the logarithm of an unknown focal length
    # share of a frame that moves on its own: beside more of it, depth is doubtful. Set by hand: in
    # a traffic jam with 0.4, the rest was off by three times the expected error
    max_moving_share: float = 0.35
    # px of the shrunk frames: motion of points at infinity that shows fixed texture
    min_infinity_motion: float = 2.0


LIMITS = Limits()


@dataclass(frozen=True, kw_only=True)
class PairEvidence:
    """Evidence of one pair of frames: the motion of a path, compared with a free motion.

    The free motion is the motion of the camera that fits the image motion of the pair best. For a
    right path, ratios and `rank` are near 1, and the rest is small.

    Attributes
    ----------
    first, second : int
        Numbers of the two frames.
    excess : float
        Share of the pixels that lie off the epipolar lines of the path, less the share that lies
        off the lines of the free motion.
    residual_ratio : float
        Residual of the path over that of the free motion.
    direction : float
        Angle between the translations of the two motions, degrees.
    direction_deviation : float
        Standard deviation of the direction of the free motion, degrees.
    rotation : float
        Angle between the rotations of the two motions, degrees.
    behind : float
        Share of the pixels that the motion of the path places behind the camera.
    rank : float or None
        Rank correlation of the depth of the first frame with that of the free motion; None without
        depth.
    zoom : float
        Logarithm of the zoom between the frames that fits best.
    zoom_deviation : float
        Standard deviation of `zoom`, with a prior of 0.03: near 0.03, the pair shows no zoom.
    zoom_gain : float
        Residual of the free motion over that of a free motion with zoom.
    parallax : float
        Median image motion beyond that of the rotation, as a share of the longer side.
    focal_value, focal_deviation : float
        Logarithm of the focal length that fits the image motion of the pair best over the one of
        the path, and its standard deviation.
    focal_depth, focal_direction, focal_rotation : float
        Largest changes by another focal length that the image motion allows: of depth, relative; of
        the direction of motion and of the rotation, degrees.

    Examples
    --------
    >>> import tisfm
    >>> result = tisfm.Reconstruction.load("walk")
    >>> pair = result.checks[0].pairs[0]
    >>> pair.excess < 0.05, pair.residual_ratio < 1.6
    (True, True)
    """

    first: int
    second: int
    excess: float
    residual_ratio: float
    direction: float
    direction_deviation: float
    rotation: float
    behind: float
    rank: float | None
    zoom: float
    zoom_deviation: float
    zoom_gain: float
    parallax: float
    focal_value: float
    focal_deviation: float
    focal_depth: float
    focal_direction: float
    focal_rotation: float

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> "PairEvidence":
        """Return the evidence of a record with a number for each field."""
        numbers: dict[str, Any] = {name: float(record[name]) for name in record if name != "rank"}
        numbers |= {name: int(record[name]) for name in ("first", "second")}
        rank = record["rank"]
        return cls(**numbers, rank=None if rank is None else float(rank))


@dataclass(frozen=True, kw_only=True)
class PathCheck:
    """The checks of a piece of the camera path against the image motion between its frames.

    Attributes
    ----------
    pairs : tuple of PairEvidence
        Evidence of pairs of frames.
    fixed_share : float
        Share of the texture that is fixed on the sensor.
    infinity_motion : float
        Motion of points at infinity, px of frames shrunk for flow: fixed texture is seen only if
        it is large.
    parts : tuple of PathCheck
        If chunks of frames were joined to the piece, the check of each chunk. If the images joined
        parts without common tracks, the check of the piece, and of the pair across each joint. If
        one of them contradicts its part of the path, the whole piece is contradicted. Empty for one
        part.

    Examples
    --------
    >>> import tisfm
    >>> result = tisfm.Reconstruction.load("walk")
    >>> [check.objections for check in result.checks]  # no check contradicts the path
    [()]
    """

    pairs: tuple[PairEvidence, ...]
    fixed_share: float
    infinity_motion: float
    parts: tuple["PathCheck", ...] = ()

    def median(self, name: str) -> float:
        """Return the median of a number over pairs; NaN without pairs."""
        values = [getattr(pair, name) for pair in self.pairs]
        known_values = [value for value in values if value is not None]
        return float(np.median(known_values)) if known_values else float("nan")

    @property
    def residual_factor(self) -> float:
        """By how much the residual exceeds that of the free motions, at least 1; 1 without pairs.

        Deviations of depth that take the path as right are too small by this factor.
        """
        ratio = self.median("residual_ratio")
        return 1.0 if np.isnan(ratio) else max(ratio, 1.0)

    def as_json(self) -> dict[str, Any]:
        """Return the numbers for JSON."""
        return {
            "pairs": [asdict(pair) for pair in self.pairs],
            "fixed_share": self.fixed_share,
            "infinity_motion": self.infinity_motion,
            "parts": [part.as_json() for part in self.parts],
        }

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> "PathCheck":
        """Return the check of a record of `as_json`."""
        return cls(
            pairs=tuple(PairEvidence.from_json(pair) for pair in record["pairs"]),
            fixed_share=float(record["fixed_share"]),
            infinity_motion=float(record["infinity_motion"]),
            parts=tuple(cls.from_json(part) for part in record["parts"]),
        )

    @classmethod
    def joined(cls, parts: Sequence["PathCheck"]) -> "PathCheck":
        """Return the check of a piece that consists of parts; at least one."""
        if len(parts) == 1:
            return parts[0]
        most_fixed = max(parts, key=lambda part: part.fixed_share)
        return cls(
            pairs=tuple(pair for part in parts for pair in part.pairs),
            fixed_share=most_fixed.fixed_share,
            infinity_motion=most_fixed.infinity_motion,
            parts=tuple(parts),
        )

    def renumbered(self, numbers: Mapping[int, int]) -> "PathCheck":
        """Return the check with other numbers of frames."""
        pairs = tuple(
            replace(pair, first=numbers[pair.first], second=numbers[pair.second])
            for pair in self.pairs
        )
        parts = tuple(part.renumbered(numbers) for part in self.parts)
        return replace(self, pairs=pairs, parts=parts)

    @property
    def zoom(self) -> tuple[float, float]:
        """Logarithm of the zoom from frame to frame, and the number of its deviations from 0.

        Pairs whose deviation is that of the prior do not count: a camera that moves along its axis
        hardly shows a zoom.
        """
        pairs = self._zoom_pairs
        if not pairs:
            return 0.0, 0.0
        steps = np.array([pair.second - pair.first for pair in pairs])
        zooms = np.array([pair.zoom for pair in pairs]) / steps
        deviations = np.array([pair.zoom_deviation for pair in pairs])
        weights = steps**2 * (1 / deviations**2 - 1 / LIMITS.zoom_prior**2)
        mean = (zooms * weights).sum() / weights.sum()
        # Pairs that contradict each other show no zoom: pairs of a plane do so.
        scatter = np.sqrt((weights * (zooms - mean) ** 2).sum() / max(len(zooms) - 1, 1))
        return float(np.median(zooms)), float(mean * np.sqrt(weights.sum()) / max(scatter, 1.0))

    @property
    def _zoom_pairs(self) -> list[PairEvidence]:
        """Pairs that know more about the zoom than the prior."""
        return [pair for pair in self.pairs if pair.zoom_deviation < LIMITS.zoom_prior]

    @property
    def focal_spread(self) -> float:
        """How far the pairs together leave the focal length open, relative.

        It is the standard deviation of their mean, with the distance of the mean from the focal
        length of the path. A pair that knows no more than is likely before has no weight.
        """
        if not self.pairs:
            return float("nan")
        values = np.array([pair.focal_value for pair in self.pairs])
        deviations = np.array([pair.focal_deviation for pair in self.pairs])
        weights = np.maximum(1 / deviations**2 - 1 / LIMITS.focal_prior**2, 0)
        total = weights.sum() + 1 / LIMITS.focal_prior**2
        return float(np.hypot((weights * values).sum() / total, 1 / np.sqrt(total)))

    @property
    def objections(self) -> tuple[str, ...]:
        """Names of the checks whose evidence is beyond its limit."""
        if self.parts:
            return tuple(dict.fromkeys(name for part in self.parts for name in part.objections))
        found = []
        if self.pairs:
            direction, deviation = self.median("direction"), self.median("direction_deviation")
            zoom, significance = self.zoom
            tests = {
                "excess": self.median("excess") > LIMITS.max_excess,
                "residual": self.median("residual_ratio") > LIMITS.max_residual_ratio,
                "direction": direction
                > max(LIMITS.max_direction, LIMITS.max_direction_deviations * deviation),
                "rank": self.median("rank") < LIMITS.min_rank,
                "behind": self.median("behind") > LIMITS.max_behind,
                "zoom": abs(zoom) > LIMITS.max_zoom_per_frame
                and abs(significance) > LIMITS.min_zoom_significance
                and np.median([pair.zoom_gain for pair in self._zoom_pairs]) > LIMITS.min_zoom_gain,
            }
            found = [name for name, objects in tests.items() if objects]
        if (
            self.fixed_share > LIMITS.max_fixed_share
            and self.infinity_motion > LIMITS.min_infinity_motion
        ):
            found.append("fixed")
        return tuple(found)

    @property
    def contradicts(self) -> bool:
        """Whether the checks contradict the path: zoom or fixed alone, or two of the others."""
        if self.parts:
            return any(part.contradicts for part in self.parts)
        return bool({"zoom", "fixed"} & set(self.objections)) or len(self.objections) > 1

    @property
    def doubt(self) -> str:
        """What speaks against the path without contradicting it; "" if nothing does.

        It is a wrong order of depth or, in a path without depth, one pair of frames whose texture
        leaves its epipolar lines and whose residual is too large. Either is a contradiction where
        the images show what misleads the tracks, such as a pattern that is fixed on the sensor.
        """
        if self.contradicts:
            return ""
        if self.parts:
            doubts = ((part.span_text, part.doubt) for part in self.parts)
            return next(
                (f"a part of the frames{span}: {doubt}" for span, doubt in doubts if doubt), ""
            )
        if "rank" in self.objections:
            return (
                "depth has another order than the image motion between the frames (rank "
                f"correlation {self.median('rank'):.2f})"
            )
        if any(pair.rank is not None for pair in self.pairs):
            return ""
        doubtful = {"excess", "residual"}
        for pair in self.pairs:
            alone = replace(self, pairs=(pair,))
            if doubtful <= set(alone.objections):
                evidence = alone._describe(sorted(doubtful))
                return (
                    f"the image motion between frames {pair.first} and {pair.second} contradicts "
                    f"the path: {evidence}"
                )
        return ""

    @property
    def span_text(self) -> str:
        """The frames between which there is evidence, in words; "" without pairs."""
        numbers = [number for pair in self.pairs for number in (pair.first, pair.second)]
        return f", {min(numbers)} to {max(numbers)}" if numbers else ""

    @property
    def message(self) -> str:
        """The evidence that contradicts the path, and advice; "" if nothing does."""
        if not self.contradicts:
            return ""
        if self.parts:
            wrong_part = next(part for part in self.parts if part.contradicts)
            return f"a part of the frames{wrong_part.span_text}: {wrong_part.message}"
        objections = self.objections
        if "fixed" in objections:
            return (
                f"{self.fixed_share:.0%} of the texture is fixed on the sensor while the camera "
                "turns: pose and depth are wrong. Give a mask of it"
            )
        if "zoom" in objections:
            zoom = self.zoom[0]
            return (
                f"the picture {'grows' if zoom > 0 else 'shrinks'} by "
                f"{100 * abs(np.expm1(zoom)):.1f} % per frame beyond the motion: the "
                "focal length changes or is wrong, or the lens distorts; give the true camera, or "
                'calibrate="radial"'
            )
        return (
            "the image motion contradicts the path or its depth: "
            f"{self._describe(objections)}. Give the focal "
            'length, a mask of moving objects or motion="objects", or other frames'
        )

    def _describe(self, objections: Sequence[str]) -> str:
        """Return the evidence of some checks in words."""
        texts = {
            "excess": f"{self.median('excess'):.0%} of the texture moves off its epipolar lines",
            "residual": "its residual is "
            f"{self.median('residual_ratio'):.1f} times that of another motion",
            "direction": "the camera moves in another direction, "
            f"{self.median('direction'):.0f}° off",
            "rank": "the depth of the frames has another order "
            f"(rank correlation {self.median('rank'):.2f})",
            "behind": f"{self.median('behind'):.0%} of the texture would lie behind the camera",
        }
        return "; ".join(texts[name] for name in objections)


UNCHECKED = PathCheck(pairs=(), fixed_share=0.0, infinity_motion=0.0)
"""The check of a piece whose positions are unknown, or whose frames are too far apart."""
