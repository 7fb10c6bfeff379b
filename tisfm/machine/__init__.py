"""What a process finds on its machine, and does not always suit the libraries that we use.

Here: limits of the address space, the cache of kernels that others may have left half-written,
memory that is freed, the device that Vulkan offers, what a process that works for another checks
first, and times and sizes in words.
May import: of the top level `version`.
"""
