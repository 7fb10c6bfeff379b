"""How good labels, depth and motion of moving things are: ``python -m bench.objects``.

`scores` compares what was found with what is true in rendered scenes; `statue` measures a real
sequence. ``python -m bench.objects.sequences`` labels whole `clips`: its methods are in
`sequence_methods`, with peers of `background` and `flow_clusters`, and `sequence_scores` compares
them. Imports tisfm, `bench.shared`, and from `bench.depth` the two-stage methods and scores of
depth.
"""
