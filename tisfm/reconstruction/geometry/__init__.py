"""Geometry that several stages share: similarity transforms, their robust fits and their graph.

May import: `camera` and `rigid`.
"""
