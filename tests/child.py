"""A module run as a process with the tests' random hash: `python -m tests.child MODULE [ARGUMENTS]`.

Its programs are then those of the tests' own process, which it reads from the cache instead of compiling them.
"""

import runpy
import sys

from tests import threefry

COMMAND = [sys.executable, "-m", "tests.child"]

if __name__ == "__main__":
    threefry.install()
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
