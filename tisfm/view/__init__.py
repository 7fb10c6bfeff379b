"""A viewer in the browser for the folders of `tisfm run` and `tisfm reconstruct`.

Here: points, colours and pictures of frames, and the page that shows them.
May import: `tisfm.exports` (the video of a fly-through), `tisfm.formats`, `tisfm.reconstruction`
(pictures of a running command), `tisfm.results`, `tisfm.show`, `tisfm.templates`, and of the top
level `grade` and `status`.
"""
