"""Motion models: what the solver is asked for, and what is made of its answer.

Here: ``"field"``, ``"camera"`` and, in `tisfm.motion.objects`, ``"objects"``; first motions,
egomotion, plane sweep, depth under rigid motions, agreement of frames and poses.
May import: `tisfm.solver`, `tisfm.visibility`, `tisfm.kernels`, and of the top level `camera`,
`checks`, `outcome`, `rigid`, `runtime`, `second_thread` and `settings`.
"""
