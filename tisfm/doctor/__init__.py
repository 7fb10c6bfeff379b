"""What is wrong with an installation or a machine, told in words.

Nothing of it needs a library that may be broken: what is tried out is tried in other processes,
which may crash or hang.

Here: what is looked at, the processes that try things out, and the text.
May import: `tisfm.machine`, of the top level `threads`, and, in those processes alone, `runtime`.
"""
