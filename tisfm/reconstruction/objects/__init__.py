"""Things that move on their own in a sequence: what belongs to each, over time.

Here: image motion between neighbouring frames both ways, what of it the camera's motion does not
explain, labels with identities that last, and each thing's path and depth in axes of its own.
May import: what `tisfm.reconstruction` may, and `tisfm.motion.objects`.
"""
