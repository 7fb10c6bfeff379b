"""Boxes of the cars in the 24 frames of KITTI's `kitti_cars`, drawn by hand.

The camera moves 3.8 m in 16 frames: everything at rest, such as the traffic light, comes 3.8 m
nearer. A car moves if it comes nearer by less. Distances are from the laser scanner.
"""

from dataclasses import dataclass

import numpy as np

FRAMES = 24
NEAR = 30.0  # m


@dataclass(frozen=True, kw_only=True)
class Car:
    """A car, and boxes around its visible part.

    Attributes
    ----------
    name : str
    distance : float
        In the first frame, m.
    boxes : dict of int to tuple
        By frame, (x0, y0, x1, y1), px: the first column and row, and the ends, exclusive.
    moves : bool
        False if it stands in all frames.
    hidden : bool
        Whether more than half of it is hidden in all frames.
    """

    name: str
    distance: float
    boxes: dict[int, tuple[int, int, int, int]]
    moves: bool = False
    hidden: bool = False

    def box(self, frame: int) -> tuple[slice, slice]:
        """Return rows and columns of its box in a frame, interpolated between given boxes."""
        frames = list(self.boxes)
        sides = np.array(list(self.boxes.values()), float).T
        x0, y0, x1, y1 = (round(np.interp(frame, frames, side)) for side in sides)
        return slice(y0, y1), slice(x0, x1)


CARS = (
    # The trailer is 3 m away. The cab moves 6.8 m in 16 frames.
    Car(
        name="tanker",
        distance=3.0,
        moves=True,
        boxes={
            0: (780, 0, 1242, 375),
            4: (771, 0, 1242, 375),
            8: (763, 0, 1242, 375),
            12: (756, 0, 1242, 375),
            16: (750, 0, 1242, 375),
            20: (745, 0, 1242, 375),
            23: (741, 0, 1242, 375),
        },
    ),
    # 7.8 m away, 6.8 m after 16 frames: it moves 2.7 m.
    Car(
        name="estate ahead",
        distance=7.8,
        moves=True,
        boxes={
            0: (556, 188, 700, 315),
            4: (556, 189, 704, 318),
            8: (556, 190, 709, 322),
            12: (555, 190, 713, 326),
            16: (554, 191, 718, 330),
            20: (552, 192, 725, 337),
            23: (551, 194, 731, 343),
        },
    ),
    # 19.3 m and 17.7 m: it moves 2.1 m. Only its roof is visible, above the roof of the estate car.
    Car(
        name="roof before the estate",
        distance=19.3,
        moves=True,
        hidden=True,
        boxes={
            0: (588, 179, 638, 190),
            8: (590, 180, 638, 192),
            16: (586, 179, 639, 192),
            23: (587, 179, 641, 194),
        },
    ),
    # The cars below stand. The front wheel of this car comes nearer like the lines on the road.
    Car(
        name="hatchback on the left",
        distance=5.4,
        boxes={
            0: (62, 182, 415, 375),
            4: (0, 185, 392, 375),
            8: (0, 187, 363, 375),
            12: (0, 190, 326, 375),
            16: (0, 197, 277, 375),
            20: (0, 229, 217, 375),
            23: (0, 293, 158, 375),
        },
    ),
    # 12.3 m and 8.5 m.
    Car(
        name="lorry on the left",
        distance=12.3,
        boxes={
            0: (348, 147, 507, 263),
            4: (318, 145, 500, 271),
            8: (290, 143, 492, 279),
            12: (258, 138, 484, 288),
            16: (220, 134, 476, 298),
            20: (178, 130, 467, 309),
            23: (140, 127, 460, 319),
        },
    ),
    # 20.0 m and 16.1 m.
    Car(
        name="saloon before the lorry",
        distance=20.0,
        boxes={
            0: (500, 180, 527, 232),
            4: (493, 181, 523, 236),
            8: (487, 181, 520, 239),
            12: (478, 181, 514, 242),
            16: (471, 181, 509, 244),
            20: (460, 182, 504, 247),
            23: (452, 182, 501, 250),
        },
    ),
    # 26.5 m and 22.7 m.
    Car(
        name="van before the saloon",
        distance=26.5,
        boxes={
            0: (499, 167, 541, 218),
            4: (492, 167, 539, 220),
            8: (485, 167, 537, 222),
            12: (478, 165, 534, 222),
            16: (472, 165, 530, 224),
            20: (466, 164, 526, 225),
            23: (462, 163, 524, 226),
        },
    ),
    # 29.0 m and 25.3 m.
    Car(
        name="saloon before the tanker",
        distance=29.0,
        boxes={
            0: (687, 179, 738, 216),
            8: (691, 180, 746, 220),
            16: (696, 179, 751, 220),
            23: (698, 179, 745, 220),
        },
    ),
    # 37.1 m and 33.3 m.
    Car(
        name="van before the saloon on the right",
        distance=37.1,
        boxes={
            0: (667, 168, 710, 203),
            8: (669, 167, 713, 203),
            16: (671, 166, 719, 205),
            23: (673, 165, 722, 207),
        },
    ),
)
