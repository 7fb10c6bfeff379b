"""Why frames have no pose: noise, light, fixed patterns, planes, repetition, too little texture.

May import: `camera`, `status`, `reconstruction.frames`, `reconstruction.mapping`,
`reconstruction.rotation` and `reconstruction.tracks`.
"""
