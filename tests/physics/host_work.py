"""Work for the workers of a stream, in a module that a process imports at once."""

import os

import numpy as np


def refuse(rows):
    raise ValueError("no such state")


def where(rows):
    """Return twice the first column, and the number of the process."""
    return np.stack([2 * rows[:, 0], np.full(len(rows), os.getpid())], axis=1)
