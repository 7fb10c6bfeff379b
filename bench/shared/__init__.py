"""Common code of the benchmarks.

`problems` has the pairs and checks of the kernel timings. `contest`, `contest_report` and `figures`
compare methods of flow. `sequences` finds pairs with true flow. `peer_process`, `peer_worker` and
`worker` run other libraries. `command` has options and progress, `results` tables, bars and files.
Imports tisfm, `bench.reference`, and nothing else of bench.
"""
