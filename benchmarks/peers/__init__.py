"""What people would train seeds with instead: one script a peer, run by `benchmarks.run` in an environment of their own.

A script prints one line of JSON, its row. A lane-step is one control step and one gradient step of one seed.
"""

import time

BEGAN = time.perf_counter()
"""When this process came here: what a script counts its start from."""
