"""Several rigid motions, a label for every pixel: ``motion="objects"``.

Here: candidates for motions, layers and their labels (Potts), what floats, and scales aligned at
contacts.
May import: what `tisfm.motion` may, and `tisfm.motion`.
"""
