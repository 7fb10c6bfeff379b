"""How good labels, depth and motion of moving things are: ``python -m bench.objects``.

`scores` compares what was found with what is true in rendered scenes; `statue` measures a real
sequence. Imports tisfm, `bench.shared`, and from `bench.depth` the two-stage methods and scores of
depth.
"""
