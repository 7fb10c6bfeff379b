"""Whether a result that is reported as good is wrong, on sequences and pairs that tempt it.

`worlds` has the rendered scenes, `films` renders their frames with a disturbance, `cases` lists the
rendered and the real inputs, `judge` compares results with the truth, `worker` runs a case in its
own process, and `report` makes the tables.
"""
