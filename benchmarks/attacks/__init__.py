"""Attacks on the package: damaged files, hostile input, signals, full disks; `python -m benchmarks.attacks`."""
