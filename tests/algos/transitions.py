"""Transitions by hand, for the functions of a method that take a sampled batch."""

import numpy as np

from earl_jax.algos.learner.replay import TransitionBatch, TransitionFlags


def make_batch(state, next_state, goal=0, action_size=3, no_successor=False, **fields):
    """Return transitions in the first rows, at the indices `goal`, without action and reward, but for other `fields`."""
    size = len(state)
    no, zeros = np.zeros(size, bool), np.zeros(size, np.float32)
    flags = TransitionFlags(np.broadcast_to(goal, size), no, no, no | no_successor, no)
    action = np.zeros((size, action_size), np.float32)
    batch = TransitionBatch(np.arange(size), np.float32(state), action, np.float32(next_state), zeros, flags, no)
    return batch._replace(**fields)
