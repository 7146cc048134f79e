"""The original's wrappers, for envs whose `step` returns four values."""

from typing import Any

import numpy as np


class Wrapper:
    """An env that forwards access to public attributes to the env that it wraps, like gym's `Wrapper`."""

    def __init__(self, env: Any):
        """Wrap `env`, which has `reset` and old gym's `step` with four values."""
        self.env = env
        self.num_interventions = 0
        self._steps = 0

    def __getattr__(self, name: str) -> Any:
        """Return the attribute of the wrapped env."""
        if name.startswith("_") or name == "env":
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        return getattr(self.env, name)

    def reset(self) -> np.ndarray:
        """Return the first observation [s + g] after an intervention, which is counted."""
        self.num_interventions += 1
        self._steps = 0
        return self.env.reset()
