"""A viewer in the browser for what `tisfm run` and `tisfm reconstruct` leave.

Here: the results as frames that are read when they are looked at, their points, colours and
pictures, and the page that shows them.
May import: `tisfm.exports` (the video of a fly-through), `tisfm.formats`, `tisfm.reconstruction`
(the folder of a result), `tisfm.results`, `tisfm.show`, and of the top level `status`.
"""
