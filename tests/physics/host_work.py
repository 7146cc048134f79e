"""Work for the workers of a stream, and jobs for them, in a module that a process imports at once."""

import os
import time

import numpy as np

from earl_jax.physics.host_call.workers import DEPTH, SPAN, Workers

DEADLINE_S = 60


def double(rows):
    """Return twice the first two columns."""
    return 2 * rows[:, :2]


def refuse(rows):
    raise ValueError("no such state")


def where(rows):
    """Return twice the first column, and the number of the process."""
    return np.stack([2 * rows[:, 0], np.full(len(rows), os.getpid())], axis=1)


class Jobs:
    """Does what a stream and a GPU do: it writes rows and a word, and waits for the answer."""

    def __init__(self, serve, count, number=0):
        self.workers, self.number, self.layouts = Workers(serve, 2, count), number, {}

    def __call__(self, lanes):
        self.number += 1
        if lanes not in self.layouts:
            self.layouts[lanes] = self.workers.new_layout(lanes, 3, self.number)
        layout = self.layouts[lanes]
        layout.rows[self.number % DEPTH] = rows = np.random.default_rng(lanes).random((lanes, 3), np.float32)
        self.workers.shared.asked[self.number % DEPTH] = self.number % SPAN + SPAN * layout.number
        wait_for(lambda: self.workers.shared.finished[0] >= self.number)
        answers = layout.answers[self.number % DEPTH]
        np.testing.assert_array_equal(answers[:, 0], 2 * rows[:, 0])
        return answers[:, 1]


def wait_for(condition):
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(1e-4)
