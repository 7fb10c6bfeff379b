"""How good depth and the camera's motion are: ``python -m bench.depth``.

`contest` holds `methods` against one another on `pairs`, `scores` measures and `report` writes;
`two_stage` is flow, essential matrix and triangulation, which tisfm stands beside. `focal`
(``python -m bench.focal``) measures what a wrong focal length does. Imports tisfm and
`bench.shared`.
"""
