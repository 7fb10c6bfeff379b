"""``tisfm doctor``: faults of an installation or a machine, in words.

The doctor itself imports no library that may be broken: other processes, which may crash or hang,
try libraries and kernels.

Here: the examination, the processes of its trials, and the table that it prints.
May import: `tisfm.machine`, of the top level `threads`, and, in those processes alone, `runtime`.
"""
