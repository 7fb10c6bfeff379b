"""What a process finds on its machine, and does not always suit the libraries that we use.

Here: limits of the address space, and the cache of kernels that others may have left half-written.
May import: nothing of `tisfm`.
"""
