"""What several questions share: pairs, methods, contests, their tables, the peers' processes.

`problems` and `agreement` serve the timings against the reference, `contest*` and `columns` the
comparisons of flow, `sequences` finds pairs with true flow, `peer_process` and `peer_worker` run
other libraries, `machine` says where a run was measured. Imports tisfm, and nothing of bench that
is outside this package.
"""
