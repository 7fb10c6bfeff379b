"""Several rigid motions, a label for every pixel: ``motion="objects"``.

Here: the first motion of frames far apart, candidates for motions, layers and their labels (Potts),
what floats, boundaries right to the pixel (min-sum), and scales aligned at contacts.
May import: what `tisfm.motion` may, and `tisfm.motion`.
"""
