"""Measurements that take long: each prints one table and writes it to benchmarks/results/."""
