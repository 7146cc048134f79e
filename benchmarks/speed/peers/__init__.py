"""Other ways to train seeds: one script per peer, run by `benchmarks.speed.suite` in a separate environment.

A script prints one line of JSON, its row. A lane-step is one control step and one gradient step of one seed.
"""

import time

BEGAN = time.perf_counter()
"""The time at which this process imported the package: the zero of a script's start time."""
