"""Common code of the benchmarks.

`problems` has the pairs and checks of the kernel timings. `contest`, `columns`, `contest_report`
and `contest_plot` compare methods of flow. `sequences` finds pairs with true flow. `peer_process`,
`peer_worker` and `worker` run other libraries. `command` has options and progress, `results`
tables, bars and files, `figures` colours. Imports tisfm, `bench.reference`, and nothing else of
bench.
"""
