"""Motion models: problems for the solver, and estimates from its solutions.

Here: ``"field"``, ``"camera"`` and, in `tisfm.motion.objects`, ``"objects"``; first motions,
egomotion, plane sweeps, depth under rigid motions, checks of frames and poses, rolling shutters.
May import: `tisfm.solver`, `tisfm.visibility`, `tisfm.kernels`, and of the top level `camera`,
`checks`, `grade`, `rigid`, `runtime`, `settings`, `shutter`, `status` and `threads`.
"""
