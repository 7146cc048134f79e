"""Sweeps: grids of runs, grouped into few programs, on this machine or under SLURM."""
