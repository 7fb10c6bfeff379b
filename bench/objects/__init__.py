"""Labels, depth and motion of moving objects: ``python -m bench.objects``.

`scores` compares results in rendered scenes with the truth; `statue` is a real sequence.
``python -m bench.objects.sequences`` labels whole `clips`: `sequence_methods` has the methods, with
peers of `segmentation`, and `sequence_scores` their errors. Imports tisfm, `bench.shared`, and from
`bench.depth` the two-stage methods and scores of depth.
"""
