"""Settings of the energy and of its minimisation, and named presets."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from numbers import Integral, Real
from typing import Any, Literal, get_args

from tisfm.errors import InputError, InputTypeError

Model = Literal["rigid", "translation"]
Motion = Literal["field", "camera", "objects"]
Derivatives = Literal["cube", "five_tap"]
Solver = Literal["cholesky", "closed_form"]
Preset = Literal["paper", "fast", "balanced", "accurate"]
FixedPixels = Literal["mask", "keep"]
# where the focal length of a pair comes from: the user, a guess, or the image motion of a pair
FocalOrigin = Literal["stated", "guessed", "estimated"]
"""Whether pixels that are fixed on the sensor, such as a logo, are masked."""

PAPER_SMOOTHNESS = 1e8 / 600**2  # the paper's λ = 1e8 at its f = 600, as λ̂ = λ/f²
# Bounds of weights and scales. Within them, products of several settings with grey levels and
# motions fit into float32, and α stays above the smallest pivots of the linear solvers.
MIN_SMOOTHNESS = 1e-6
MAX_SMOOTHNESS = 1e12
_MAX_WEIGHT = 1e6
_MIN_CONTRAST = 1e-3  # px/frame: below it, rounding in float32 can make the energy rise
# Upper bounds of counts: more than any use needs, but a run still ends or can be interrupted.
_MAX_COUNTS = {
    "pyramid_levels": 100,
    "finest_level": 100,
    "warps": 10_000,
    "coarse_warps": 10_000,
    "outer_iterations": 10_000,
    "sweeps": 1000,  # in one kernel launch, which cannot be interrupted
    "cycles": 1000,
    "max_objects": 255,  # the search for objects stores labels as bytes
}
_COUNTS_THAT_MAY_BE_0 = ("finest_level", "cycles")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of an interpretation; without arguments, the preset ``"balanced"``.

    Equations are numbered as in the paper of Sekkati and Mitiche (`tisfm.interpret`).

    Parameters
    ----------
    model : {"rigid", "translation"}
        Unknowns per pixel: (τ, ω), eq. 23, or τ alone, eq. 16.
    motion : {"field", "camera", "objects"}
        Motion model: ``"field"`` has a free ρ̂ = f·(τ, ω) at every pixel, as in the paper, with the
        translation over depth τ = T/Z and the rotation ω; ``"camera"`` has one rigid motion for the
        whole image, and inverse depth at every pixel; ``"objects"`` has several rigid motions, a
        label per pixel, and inverse depth in the unit of each motion.
    smoothness : float
        λ̂, weight of the regularisation. It has no unit if constraints are normalised; without
        `normalization`, λ̂ = λ/f² on the 8-bit grey scale: the paper's λ = 1e8 at f = 600 is 278.
        In [1e-6, 1e12].
    beta : float
        β of eq. 12, a factor of the smoothness: its effective weight is α = λ̂β, which must be in
        [1e-6, 1e12] too.
    contrast : float or None
        δ, px/frame: a larger difference between neighbours is an edge. In [1e-3, 1e6]: with smaller
        values, rounding in float32 can make the energy rise. It is the same at every level. None
        for δ = 1 in the units of τ and ω, that is f pixels: the paper's setting, with which
        smoothing is nearly quadratic.
    joint_edges : bool
        Whether an edge in one component is an edge for all components. Otherwise every component
        has its own edges, as in the paper.
    stiffness : tuple of 6 floats
        s_k: how strongly (τ1, τ2, τ3, ω1, ω2, ω3) are smoothed relative to `smoothness`. ω1 and ω2
        change the flow almost as τ2 and τ1 do, so they should vary little; ω3, about the optical
        axis, may vary. A softer τ3 gives better flow on slanted surfaces, but worse depth by
        eq. 24. All 1 in the paper. The translation model uses the first three.
    image_edges : float
        κ: the smoothness across an edge of the image is divided by 1 + κ|ΔI| / mean |ΔI|; the mean
        smoothness stays the same. 0 in the paper.
    brightness : float
        Weight of the constancy of brightness (eq. 4); 1 in the paper. `brightness` and `gradient`
        must not both be 0.
    gradient : float
        Weight of the constancy of the brightness gradient, on which changes of illumination have
        little effect; 0 in the paper.
    normalization : float or None
        ζ, as a share of the mean |ΔI| between neighbours in frame 0. A constraint says that a pixel
        keeps its brightness, or its gradient, along the flow. Each is divided by √(|∇I|² + ζ²); its
        residual is then a distance in px, independent of the contrast and the scale of grey levels.
        None for no division, as in the paper.
    data_contrast : float or None
        ε, px/frame (grey levels without `normalization`): the cost of larger residuals grows
        linearly instead of quadratically (Charbonnier). None for squares, as in the paper.
    depth_smoothness : float
        Weight of the regularisation of inverse depth with ``motion="camera"`` and ``"objects"``, in
        place of `smoothness`, with the same bounds.
    depth_brightness : float
        Weight of the constancy of brightness for these motions, in place of `brightness`.
    depth_normalization : float or None
        ζ for these motions, in place of `normalization`. A rigid motion leaves a pixel little
        freedom, so noise is the main disturbance, and weak gradients should have less weight than
        strong gradients.
    max_objects : int
        Maximum number of motions of ``motion="objects"``, including the motion of the background;
        at most 255.
    align_scales : bool
        Whether objects that stand on the background take its scale where they touch it
        (``motion="objects"``). Otherwise every object's depth is in the unit of its own motion.
    derivatives : {"cube", "five_tap"}
        Horn and Schunck's 2×2×2 cube, whose estimates belong half a pixel to the south-east of
        their pixel, or five taps on the mean of both frames.
    presmoothing : float
        Standard deviation, px, of a Gaussian applied to both frames first (the paper's
        Fig. 8b); 0 for none, at most 100.
    pyramid_factor : float
        Ratio of the sizes of neighbouring levels, in [0.5, 0.95].
    pyramid_levels : int or None
        Number of levels; 1 for a single scale, None for as many as keep the shorter side at
        about 12 px.
    finest_level : int
        Last level to compute; 0 is the finest. Motion, confidence and deviation of depth are
        interpolated from this level to the frame. Occlusion is decided by the residuals of this
        level. With a `pyramid_factor` of ½, level 1 has a quarter of the pixels, and motion is
        blurred over two pixels. A number beyond the coarsest level stands for the coarsest level.
        If the parallax is large, ``motion="camera"`` goes on to a finer level. ``motion="objects"``
        always uses 0.
    warps : int
        Linearisations on the last level; at least 2 with ``motion="objects"``.
    coarse_warps : int
        Maximum number of linearisations on each coarser level; a level has at most twice as many as
        the next finer level. They take little time there, and finer levels cannot correct the
        errors of a coarse level. Untextured regions have few pixels on a coarse level, so they
        quickly get the motion of their surroundings.
    outer_iterations : int
        Maximum number of half-quadratic iterations per warp; at least 10 with ``motion="objects"``.
    sweeps : int
        Red–black sweeps per half-quadratic iteration; at most 1000, and at least 8 with
        ``motion="objects"``.
    cycles : int
        Multigrid cycles with conjugate gradients per half-quadratic iteration, in place of `sweeps`
        and `relaxation`. They are faster if ρ̂ starts from zero on a single scale, as in the
        paper, but help little from coarse to fine. 0 for sweeps; if `pyramid_levels` is 1, one
        cycle then checks the result of the sweeps.
    relaxation : float
        Over-relaxation, at least 0.01 and below 2; 1 is Gauss–Seidel.
    tolerance : float
        Half-quadratic iterations, at least two, stop when ‖change of ρ̂‖ ≤ tolerance · ‖ρ̂‖. If
        `pyramid_levels` is 1, as in the paper, they stop when ‖error of ρ̂‖ ≤ tolerance · ‖ρ̂‖. The
        error is estimated from the rate at which the changes shrink. The estimate takes three
        iterations, or four with sweeps (`cycles=0`), so fewer `outer_iterations` cannot converge.
    solver : {"cholesky", "closed_form"}
        How each pixel's system is solved; both give the same answer up to rounding.

    Raises
    ------
    TypeError, ValueError
        If a value is of the wrong type or out of range; the text names the allowed values.

    Examples
    --------
    >>> import tisfm
    >>> settings = tisfm.Settings(motion="camera", smoothness=30.0)
    >>> settings.motion, settings.smoothness
    ('camera', 30.0)
    >>> tisfm.Settings(smoothness=-1.0)
    Traceback (most recent call last):
        ...
    tisfm.errors.InputError: smoothness is -1.0: expected ...
    """

    model: Model = "rigid"
    motion: Motion = "field"
    smoothness: float = 22.0
    beta: float = 1.0
    contrast: float | None = 0.02
    joint_edges: bool = True
    stiffness: tuple[float, float, float, float, float, float] = (1, 1, 0.5, 10, 10, 0.3)
    image_edges: float = 2.0
    brightness: float = 0.3
    gradient: float = 1.0
    normalization: float | None = 0.02
    data_contrast: float | None = 0.1
    depth_smoothness: float = 4.5
    depth_brightness: float = 1.0
    depth_normalization: float | None = 0.6
    max_objects: int = 8
    align_scales: bool = False
    derivatives: Derivatives = "five_tap"
    presmoothing: float = 0.6
    pyramid_factor: float = 0.5
    pyramid_levels: int | None = None
    finest_level: int = 0
    warps: int = 2
    coarse_warps: int = 8
    outer_iterations: int = 20
    sweeps: int = 5
    cycles: int = 0
    relaxation: float = 1.95
    tolerance: float = 2e-2
    solver: Solver = "closed_form"

    def __post_init__(self) -> None:
        for name, kind in (
            ("model", Model),
            ("motion", Motion),
            ("derivatives", Derivatives),
            ("solver", Solver),
        ):
            _check_choice(name, getattr(self, name), get_args(kind))
        min_weight, max_weight = MIN_SMOOTHNESS, MAX_SMOOTHNESS
        _check_real("smoothness", self.smoothness, minimum=min_weight, maximum=max_weight)
        _check_real("beta", self.beta, minimum=1 / _MAX_WEIGHT, maximum=_MAX_WEIGHT)
        if not min_weight <= float(self.smoothness) * float(self.beta) <= max_weight:
            raise InputError(
                f"smoothness · beta is {float(self.smoothness):g} · {float(self.beta):g}: expected "
                f"a product of at least {min_weight:g} and at most {max_weight:g}"
            )
        if self.contrast is not None:
            _check_real("contrast", self.contrast, minimum=_MIN_CONTRAST, maximum=_MAX_WEIGHT)
        for name in ("joint_edges", "align_scales"):
            value = getattr(self, name)
            if not isinstance(value, bool):
                raise InputTypeError(f"{name} is {value!r}: expected True or False")
        object.__setattr__(self, "stiffness", _check_stiffness(self.stiffness))
        _check_real("image_edges", self.image_edges, minimum=0, maximum=_MAX_WEIGHT)
        for name in ("brightness", "gradient"):
            _check_real(name, getattr(self, name), minimum=0, maximum=_MAX_WEIGHT)
        if not self.brightness + self.gradient > 0:
            raise InputError("brightness and gradient are both 0: give one of them a weight")
        if self.normalization is not None:
            _check_real("normalization", self.normalization, minimum=0, maximum=_MAX_WEIGHT)
        if self.data_contrast is not None:
            _check_real(
                "data_contrast", self.data_contrast, minimum=_MIN_CONTRAST, maximum=_MAX_WEIGHT
            )
        _check_real(
            "depth_smoothness", self.depth_smoothness, minimum=min_weight, maximum=max_weight
        )
        _check_real("depth_brightness", self.depth_brightness, minimum=0, maximum=_MAX_WEIGHT)
        if not self.depth_brightness + self.gradient > 0:
            raise InputError("depth_brightness and gradient are both 0: give one of them a weight")
        if self.depth_normalization is not None:
            _check_real(
                "depth_normalization", self.depth_normalization, minimum=0, maximum=_MAX_WEIGHT
            )
        _check_real("presmoothing", self.presmoothing, minimum=0, maximum=100)
        _check_real("pyramid_factor", self.pyramid_factor, minimum=0.5, maximum=0.95)
        _check_real("relaxation", self.relaxation, minimum=0.01, upper_bound=2)
        _check_real("tolerance", self.tolerance, minimum=0)
        for name, max_count in _MAX_COUNTS.items():
            if name != "pyramid_levels" or self.pyramid_levels is not None:
                min_count = 0 if name in _COUNTS_THAT_MAY_BE_0 else 1
                _check_count(name, getattr(self, name), minimum=min_count, maximum=max_count)
        # Convert to Python numbers: settings are compared, hashed and written to JSON.
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in _MAX_COUNTS and value is not None:
                object.__setattr__(self, field.name, int(value))
            elif isinstance(value, Real) and not isinstance(value, bool):
                object.__setattr__(self, field.name, float(value))

    @classmethod
    def preset(cls, name: Preset = "balanced", **changes: Any) -> "Settings":
        """Return a preset, with changes.

        Parameters
        ----------
        name : {"paper", "fast", "balanced", "accurate"}
            ``"paper"`` reproduces the paper: one scale, no warping, brightness only, β = ¼,
            λ = 1e8 at f = 600, δ = 1. The other presets trade accuracy for time.
        **changes
            Settings that differ from the preset.

        Raises
        ------
        ValueError
            If the preset does not exist, or the name or value of a change is not allowed.

        Examples
        --------
        >>> import tisfm
        >>> tisfm.Settings.preset("fast").finest_level  # it ends at half the resolution
        1
        >>> tisfm.Settings.preset("fast", motion="objects", max_objects=3).max_objects
        3
        """
        _check_choice("preset", name, tuple(_PRESETS))
        names = {field.name for field in fields(cls)}
        unknown = sorted(set(changes) - names)
        if unknown:
            raise InputError(
                f"no setting is named {', '.join(unknown)}: settings are {', '.join(sorted(names))}"
            )
        return replace(_PRESETS[name], **changes)

    @property
    def components(self) -> int:
        """Unknowns per pixel: 6 (rigid) or 3 (translation)."""
        return 6 if self.model == "rigid" else 3

    @property
    def alpha(self) -> float:
        """α = λ̂β of eq. 16 and 23."""
        return self.smoothness * self.beta

    def warps_on(self, level: int) -> int:
        """Return the number of linearisations on a level of the pyramid; 0 is the last level."""
        return self.warps if level == 0 else min(self.coarse_warps, self.warps * 2**level)

    def contrast_for(self, focal: float) -> float:
        """Return δ, px/frame, for a focal length in px."""
        return focal if self.contrast is None else self.contrast


def check_settings(settings: Settings | None) -> Settings:
    """Return the settings, by default the preset ``"balanced"``; raise if they are not settings."""
    if settings is None:
        return Settings()
    if not isinstance(settings, Settings):
        raise InputTypeError(
            f"settings is {settings!r}: expected a tisfm.Settings, "
            'for instance Settings.preset("accurate")'
        )
    return settings


def check_fixed_pixels(fixed_pixels: FixedPixels) -> None:
    """Raise InputError unless the word says whether fixed pixels are masked."""
    if fixed_pixels not in get_args(FixedPixels):
        raise InputError(f'fixed_pixels is {fixed_pixels!r}: expected "mask" or "keep"')


def _check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise InputError(f"{name} is {value!r}: expected one of {', '.join(map(repr, choices))}")


def _check_real(
    name: str,
    value: object,
    *,
    minimum: float = -math.inf,
    maximum: float = math.inf,
    lower_bound: float = -math.inf,
    upper_bound: float = math.inf,
) -> None:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputTypeError(f"{name} is {value!r}: expected a number")
    try:
        number = float(value)
    except OverflowError:  # an integer beyond the range of floats
        number = math.inf
    if not math.isfinite(number) or not (
        minimum <= number <= maximum and lower_bound < number < upper_bound
    ):
        bounds = [
            f"{word} {bound:g}"
            for word, bound in (
                ("at least", minimum),
                ("at most", maximum),
                ("above", lower_bound),
                ("below", upper_bound),
            )
            if math.isfinite(bound)
        ]
        raise InputError(f"{name} is {value}: expected a finite number {' and '.join(bounds)}")


def _check_stiffness(stiffness: object) -> tuple[float, ...]:
    if isinstance(stiffness, str) or not isinstance(stiffness, Sequence) or len(stiffness) != 6:
        raise InputTypeError(f"stiffness is {stiffness!r}: expected 6 numbers")
    for k, value in enumerate(stiffness):
        _check_real(f"stiffness[{k}]", value, minimum=1e-3, maximum=_MAX_WEIGHT)
    return tuple(float(value) for value in stiffness)


def _check_count(name: str, value: object, *, minimum: int, maximum: int) -> None:
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise InputTypeError(f"{name} is {value!r}: expected an integer")
    if not minimum <= int(value) <= maximum:
        raise InputError(f"{name} is {value}: expected at least {minimum} and at most {maximum}")


_PRESETS: dict[str, Settings] = {
    "paper": Settings(
        smoothness=PAPER_SMOOTHNESS,
        beta=0.25,
        contrast=None,
        joint_edges=False,
        stiffness=(1.0,) * 6,
        image_edges=0.0,
        brightness=1.0,
        gradient=0.0,
        normalization=None,
        data_contrast=None,
        derivatives="cube",
        presmoothing=0.0,
        pyramid_levels=1,
        warps=1,
        coarse_warps=1,
        outer_iterations=200,
        cycles=1,
        relaxation=1.9,
        tolerance=1e-2,
        solver="cholesky",
    ),
    "fast": Settings(finest_level=1, coarse_warps=4, sweeps=4, relaxation=1.97, tolerance=3e-2),
    "balanced": Settings(),
    "accurate": Settings(pyramid_factor=0.7, sweeps=6, relaxation=1.93, tolerance=1e-2),
}
