"""How widely a life has spread over the map that its lane keeps.

Source: Sharma et al. 2022, figure 4, which shows such maps without a measure; the measures are ours.
"""

import math

import numpy as np

MEASURES = ("covered", "entropy", "concentration")
CROWDED = 0.01
"""The share of bins that concentration looks at."""


def measure(visits: np.ndarray) -> dict[str, float]:
    """Return `covered`, `entropy` and `concentration` of `visits [B, B]`, all 0 to 1, and all 0 without a visit."""
    flat = np.sort(np.ravel(visits).astype(float))[::-1]
    if not flat.sum():
        return dict.fromkeys(MEASURES, 0.0)
    shares = flat / flat.sum()
    kept = shares[shares > 0]
    entropy = -(kept * np.log(kept)).sum() / math.log(flat.size) if flat.size > 1 else 0.0
    crowded = shares[: math.ceil(CROWDED * flat.size)].sum()
    return dict(zip(MEASURES, (len(kept) / flat.size, float(entropy), float(crowded)), strict=True))
