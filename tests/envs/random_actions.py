"""Actions that strain a task."""

import numpy as np

LONGEST_HOLD = 50


def make_actions(steps: int, lanes: int, size: int, seed: int = 0) -> np.ndarray:
    """Return actions [steps, lanes, size]: uniform, corners, and corners held, a third of the lanes each."""
    rng = np.random.default_rng(seed)
    uniform = rng.uniform(-1, 1, (steps, lanes, size))
    corners = np.sign(rng.uniform(-1, 1, (steps, lanes, size)))
    held = corners.copy()
    for lane in range(lanes):
        holds = rng.integers(1, LONGEST_HOLD + 1, steps)
        starts = np.cumsum(holds)[np.cumsum(holds) < steps]
        held[:, lane] = corners[
            np.concatenate([[0], starts])[np.searchsorted(starts, np.arange(steps), side="right")], lane
        ]
    kind = np.arange(lanes) % 3
    return np.select([(kind == 0)[None, :, None], (kind == 1)[None, :, None]], [uniform, corners], held).astype(
        np.float32
    )
