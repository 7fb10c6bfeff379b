"""Several rigid motions and a label for every pixel: ``motion="objects"``.

Here: the first motion of frames far apart, candidates for motions, layers and their labels (Potts),
floating parts, boundaries exact to the pixel (min-sum), and scales aligned at contacts.
May import: what `tisfm.motion` may, and `tisfm.motion`.
"""
