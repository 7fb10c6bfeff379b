"""Fusion of the depth maps of many views into one point cloud or one mesh.

Here: the views, the pixels and the points that several views agree on, a truncated signed distance
field in blocks near the surface, the mesh extracted from it, and the file of a mesh.

May import: `tisfm.formats`, `tisfm.kernels`, and of the top level `camera`, `checks`,
`point_cloud`, `rigid` and `runtime`.
"""

from tisfm.fusion.depth_views import DepthView
from tisfm.fusion.mesh import Mesh, fused_mesh
from tisfm.fusion.points import fused_points

__all__ = ["DepthView", "Mesh", "fused_mesh", "fused_points"]
