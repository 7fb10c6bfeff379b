"""Depth maps of many views, fused into one cloud of points or one mesh.

Here: the views that are fused, which points they agree on, a field of signed distances in blocks
near the surface, the mesh taken from it, and the file that keeps a mesh.
May import: `tisfm.formats`, `tisfm.kernels`, and of the top level `camera`, `checks`,
`point_cloud`, `rigid` and `runtime`.
"""

from tisfm.fusion.depth_views import DepthView
from tisfm.fusion.mesh import Mesh, fused_mesh
from tisfm.fusion.points import fused_points

__all__ = ["DepthView", "Mesh", "fused_mesh", "fused_points"]
