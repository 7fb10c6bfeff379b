"""Motion models: the problems that the solver is given, and the estimates from its solutions.

Here: ``"field"``, ``"camera"`` and, in `tisfm.motion.objects`, ``"objects"``; first motions,
egomotion, plane sweep, depth under rigid motions, checks of frames and poses, rolling shutters.
May import: `tisfm.solver`, `tisfm.visibility`, `tisfm.kernels`, and of the top level `camera`,
`checks`, `rigid`, `runtime`, `settings`, `shutter`, `status` and `threads`.
"""
