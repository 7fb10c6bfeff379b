"""A mesh fused from depth maps, and the file that stores it."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm import runtime
from tisfm.checks import refuse_masked
from tisfm.errors import InputError, MissingPackageError
from tisfm.formats import atomic_write
from tisfm.formats.glb import glb_surface
from tisfm.formats.ply_note import add_ply_note
from tisfm.fusion.agreement import (
    CACHED_VIEWS,
    MAX_COMPARED_STD,
    AgreementRule,
    Coverage,
    FittedViews,
    agreement_rule,
    compare_views,
    fit_rule,
    measure_noise,
)
from tisfm.fusion.depth_views import DepthView, PosedViews, check_positive
from tisfm.fusion.isosurface import extract_surface
from tisfm.fusion.signed_distance import (
    MAX_BLOCKS,
    DistanceField,
    VoxelTooSmallError,
    integrate_views,
)

SUFFIXES = (".ply", ".glb")


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A surface of triangles.

    Raises ValueError if the arrays have other shapes or types, a value is masked, or a face has the
    number of a vertex that does not exist.
    """

    vertices: NDArray[np.float32]  # (V, 3) float32: in the world's axes
    # (F, 3) int32: three vertices each, anticlockwise seen from the side of the cameras
    faces: NDArray[np.int32]
    colors: NDArray[np.uint8]  # (V, 3) uint8: red, green, blue
    voxel: float  # edge of the voxels of the distance field, in the unit of the vertices
    # a text for the file, such as a warning of the grade of the result
    note: str = ""

    def __post_init__(self) -> None:
        count = len(self.vertices)
        for name, shape, kind in (
            ("vertices", (count, 3), np.float32),
            ("faces", (len(self.faces), 3), np.int32),
            ("colors", (count, 3), np.uint8),
        ):
            array = getattr(self, name)
            refuse_masked(array, name, "leave out the faces that they belong to")
            if array.shape != shape or array.dtype != kind:
                raise InputError(
                    f"{name} is {array.shape} {array.dtype}: expected {shape} {np.dtype(kind).name}"
                )
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < count:
            raise InputError(
                f"faces has vertices {self.faces.min()} to {self.faces.max()}: expected 0 to "
                f"{count - 1}"
            )

    def __repr__(self) -> str:
        return f"Mesh of {len(self.vertices)} vertices and {len(self.faces)} faces"

    def save(
        self,
        path: str | os.PathLike[str],  # the file, with the suffix ``.ply`` or ``.glb``
    ) -> None:
        """Write a binary PLY or GLB file; after an error there is no incomplete file.

        A PLY file has the axes of the world: Y points down if the first camera was upright. GLB
        requires Y up: Y and Z change sign.

        Raises ValueError if the path has another suffix, or the mesh is empty and the suffix is
        ``.glb``.

        Raises OSError if the folder does not exist or cannot be written to.
        """
        suffix = Path(path).suffix.lower()
        if suffix not in SUFFIXES:
            raise InputError(f"path is {os.fspath(path)}: expected a name in .ply or .glb")
        if suffix == ".glb" and not len(self.faces):
            raise InputError(f"path is {os.fspath(path)}: a GLB file cannot hold an empty mesh")
        content = self._glb() if suffix == ".glb" else self._ply()
        with atomic_write(path) as file:
            file.write(content)

    def _glb(self) -> bytes:
        return glb_surface(
            self.vertices * np.array([1, -1, -1], np.float32),
            self.faces,
            self.colors,
            note=self.note,
        )

    def _ply(self) -> bytes:
        from trimesh import Trimesh  # slow to import
        from trimesh.exchange.ply import export_ply

        mesh = Trimesh(
            vertices=self.vertices, faces=self.faces, vertex_colors=self.colors, process=False
        )
        return add_ply_note(export_ply(mesh, "binary", vertex_normal=False), self.note)


# Defaults, set by hand:
VOXEL_PIXELS = 2.0  # edge of a voxel, px at the median depth
# Smallest edge of a voxel, median deviations of depth: smaller voxels show noise.
MIN_VOXEL_DEVIATIONS = 0.5
TRUNCATION_VOXELS = 4.0  # truncation distance, voxels
MIN_TRUNCATION_DEVIATIONS = 3.0  # smallest truncation distance, median deviations of depth
NORMAL_AGREEING = 3  # views that show a surface, with normal coverage
NORMAL_STD = 0.05  # largest relative standard deviation of depth, with normal coverage
COMPARED_STEP = 2  # px between pixels that are compared with other views
UNSEEN_GREY = 128  # grey level of vertices that no view shows
_MIN_ENLARGEMENT = 1.1  # smallest factor by which voxels grow if the default is too small


def fused_mesh(
    # Any object with a length and items. Views are read one by one, four times each.
    views: Sequence[DepthView],
    *,
    # How much is kept. "normal": depth up to a stated deviation, where three views show a surface.
    # "strict" and "complete": the depth that `fused_points` keeps.
    coverage: Coverage = "normal",
    # number of views that must show the surface near a voxel; all views if there
    # are fewer; by default 3, or 1 for "complete"
    agreeing: int | None = None,
    # Depth with a larger relative standard deviation is not used. By default 0.05, as stated;
    # "strict" and "complete" as for `fused_points`.
    max_relative_std: float | None = None,
    # depth beyond this multiple of the median depth of its view is not used; None
    # for no bound
    max_depth: float | None = 5.0,
    # Edge of a voxel, in the unit of the poses. By default the largest of 2 px at the median depth,
    # half the median deviation of depth, and the edge with which the field fills 1 GB;
    # `Mesh.voxel` is the edge.
    voxel: float | None = None,
    # Greatest distance from the surface in the field, in the unit of the poses. Objects must be
    # thicker. By default the larger of 4 voxels and 3 median deviations of depth.
    truncation: float | None = None,
) -> Mesh:
    """Fuse depth maps into a mesh by a truncated signed distance field (TSDF).

    A voxel near the surface stores the mean of its signed distances in all views, weighted by their
    precision. Space in front of a surface counts as empty, so that errors of single views vanish.
    The mesh lies where the mean distance is zero, and is open where too few views show the surface.

    The mesh has the axes and the unit of the world, and no faces if no surface is found. Colours
    are means over the views, weighted by 1/Z².

    Raises ModuleNotFoundError if scikit-image is not installed.

    Raises TypeError, ValueError if an option or a view is not valid, or voxels of the given size
    would need too much memory.

    References
    ----------
    Curless and Levoy, "A volumetric method for building complex models from range images", SIGGRAPH
    1996, doi 10.1145/237170.237269; Lewiner et al., "Efficient implementation of marching cubes'
    cases with topological guarantees", 2003, doi 10.1080/10867651.2003.10487582.
    """
    rule = agreement_rule(coverage, agreeing, max_relative_std)
    if coverage == "normal":
        rule = replace(rule, agreeing=NORMAL_AGREEING if agreeing is None else agreeing)
    for name, value in (("voxel", voxel), ("truncation", truncation)):
        if value is not None:
            check_positive(value, name)
    check_scikit_image()
    runtime.start()
    if coverage == "normal":
        bound = NORMAL_STD if max_relative_std is None else max_relative_std
        posed_views = PosedViews(views, max_relative_std=bound, max_depth=max_depth)
    else:
        posed_views = _agreed_views(views, rule, max_depth)
    if not len(posed_views):
        empty_array = np.empty((0, 3))
        return Mesh(
            vertices=empty_array.astype(np.float32),
            faces=empty_array.astype(np.int32),
            colors=empty_array.astype(np.uint8),
            voxel=float(voxel or 0),
        )
    min_views = min(rule.agreeing, len(posed_views))
    field, truncation_distance = _build_field(posed_views, voxel, truncation, min_views)
    vertices, faces = extract_surface(field, min_views)
    colors = _mean_colors(posed_views, vertices, truncation_distance)
    return Mesh(
        vertices=(vertices * posed_views.unit).astype(np.float32),
        faces=faces,
        colors=colors,
        voxel=field.voxel * posed_views.unit,
    )


def _agreed_views(
    views: Sequence[DepthView], rule: AgreementRule, max_depth: float | None
) -> PosedViews:
    """Return the views without the depth that too few views agree on.

    Every second pixel of every second row is compared, and stands for the pixels beside it.
    """
    all_views = PosedViews(
        views,
        max_relative_std=MAX_COMPARED_STD,
        max_depth=max_depth,
        cached_views=CACHED_VIEWS,
    )
    noise = measure_noise(all_views)
    rule = fit_rule(rule, all_views, noise)
    fitted_views, masks = FittedViews(all_views, noise), {}
    for n in range(len(fitted_views)):
        height, width = fitted_views[n].inverse_depth.shape
        thinned_view = fitted_views[n].thinned(COMPARED_STEP)
        is_candidate = np.ones(thinned_view.inverse_depth.shape, bool)
        others = fitted_views.neighbours(n)
        is_kept = compare_views(thinned_view, others, is_candidate, rule, noise).is_kept
        mask = np.repeat(np.repeat(is_kept, COMPARED_STEP, axis=0), COMPARED_STEP, axis=1)
        masks[all_views.index(n)] = np.packbits(mask[:height, :width])
    return PosedViews(views, max_relative_std=MAX_COMPARED_STD, max_depth=max_depth, masks=masks)


def _build_field(
    views: PosedViews, voxel: float | None, truncation: float | None, agreeing: int
) -> tuple[DistanceField, float]:
    """Return the field and its truncation distance, in the unit of the views."""
    deviation = float(np.median([summary.deviation for summary in views.summaries]))
    if voxel is None:
        pixel = float(np.median([summary.depth / summary.focal for summary in views.summaries]))
        voxel_side = max(VOXEL_PIXELS * pixel, MIN_VOXEL_DEVIATIONS * deviation)
    else:
        voxel_side = voxel / views.unit
    while True:
        if truncation is None:
            truncation_distance = max(
                TRUNCATION_VOXELS * voxel_side, MIN_TRUNCATION_DEVIATIONS * deviation
            )
        else:
            truncation_distance = truncation / views.unit
        try:
            return integrate_views(
                views, voxel_side, truncation_distance, agreeing
            ), truncation_distance
        except VoxelTooSmallError as error:
            if voxel is not None:
                raise InputError(
                    f"voxel is {voxel:g}: the surface would need more than {MAX_BLOCKS} blocks of "
                    f"8×8×8 voxels, the most that is kept in memory; give at least "
                    f"{1.05 * error.factor * voxel:.2g}, or a smaller max_depth"
                ) from None
            voxel_side *= max(_MIN_ENLARGEMENT, error.factor)


def _mean_colors(
    views: PosedViews, vertices: NDArray[np.float64], max_distance: float
) -> NDArray[np.uint8]:
    """Return the mean colour of each vertex, (V, 3)."""
    from tisfm.kernels.fusion.agreement import add_colors

    points = vertices.astype(np.float32)
    sums = np.zeros((len(points), 4), np.float32)
    for view in views if len(points) else ():
        add_colors(
            points,
            view.inverse_depth,
            view.colors,
            sums,
            projection=view.to_pixels.astype(np.float32),
            max_distance=max_distance,
        )
    is_shown = sums[:, 3:] > 0
    mean = np.where(is_shown, sums[:, :3] / np.where(is_shown, sums[:, 3:], 1), UNSEEN_GREY)
    return np.rint(mean).astype(np.uint8)


def check_scikit_image() -> None:
    """Raise ModuleNotFoundError, which says what to install, if scikit-image is missing."""
    try:
        import skimage.measure  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            "a mesh needs scikit-image, which is not installed: pip install 'tisfm[mesh]'",
            name=error.name,
        ) from None
