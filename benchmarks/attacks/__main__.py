"""Attack the package: `python -m benchmarks.attacks --out benchmarks/results/attacks`.

Every case states what is expected, runs in bounded processes, and is reported as survived or failed. The exit code is 1 if one
failed. The cases of the class `recordings` and others read hostile files, so run this where nothing depends on the machine.
"""

import argparse
import os
import signal
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a process with threads should not fork

from benchmarks.attacks import results, runner
from benchmarks.attacks.catalogue import CLASSES, select


def main() -> None:
    """Run the selected cases and write the results."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.attacks", description=__doc__)
    parser.add_argument("--classes", nargs="+", choices=list(CLASSES), default=[])
    parser.add_argument("--fast", action="store_true", help="only the cases that are also tests")
    parser.add_argument("--case", default="", help="only the cases whose name contains this text")
    parser.add_argument("--every", type=int, default=1, help="only every n-th of these cases")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell lets background commands ignore it
    with tempfile.TemporaryDirectory(prefix="attacks-") as name:
        root = Path(name)
        runner.self_test(root)
        rows = runner.run_cases(select(arguments.classes, arguments.fast, arguments.case)[:: arguments.every], root)
    command = " ".join(["python -m benchmarks.attacks", *sys.argv[1:]])
    print(results.markdown(rows, command))
    if arguments.out:
        results.write(arguments.out, rows, command)
    if any(row["verdict"] == "failed" for row in rows):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
