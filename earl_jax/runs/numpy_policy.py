"""A learnt policy in plain NumPy. This file imports nothing else, so it can be copied to a machine without jax."""

import dataclasses
from pathlib import Path

import numpy as np

FULL_BUDGET = 1.0
"""The share of the budget for help that a policy observes; nothing is charged."""


@dataclasses.dataclass(frozen=True, repr=False, eq=False)
class NumpyPolicy:
    """The greedy policy `policy(obs [..., o]) -> action [..., a]`, float32: tanh of the first outputs of a ReLU network.

    `layers` are the kernels [k, l] and biases [l] of the network. After training with a budget for help, the policy
    observes a full budget at index `budget_at`. After training in `bf16`, it rounds as the learner does, because it can
    fail without this rounding.
    """

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    action_size: int
    budget_at: int | None = None
    bf16: bool = False

    def __repr__(self) -> str:
        layers = "-".join(str(len(bias)) for _, bias in self.layers[:-1])
        obs_size = len(self.layers[0][0]) - (self.budget_at is not None)
        return f"NumpyPolicy(obs [..., {obs_size}] -> action [..., {self.action_size}], {layers})"

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return the greedy action [..., a] at `obs [..., o]`; a ValueError if `obs` has another size."""
        x, size = np.asarray(obs, np.float32), len(self.layers[0][0]) - (self.budget_at is not None)
        if x.shape[-1:] != (size,):
            raise ValueError(f"obs has shape {x.shape}, this policy takes (..., {size})")
        if self.budget_at is not None:
            x = np.insert(x, self.budget_at, FULL_BUDGET, axis=-1)
        rounded = _bf16 if self.bf16 else np.asarray
        *hidden, (last_kernel, last_bias) = self.layers
        for number, (kernel, bias) in enumerate(hidden):
            sums = rounded(x) @ rounded(kernel)
            x = np.maximum(rounded(sums) + bias if number else sums + rounded(bias), 0)
        return np.tanh((rounded(x) @ rounded(last_kernel) + last_bias)[..., : self.action_size])

    def save(self, path: str | Path) -> None:
        """Write the policy to `path`, an .npz of plain arrays."""
        arrays = {"action_size": np.asarray(self.action_size), "bf16": np.asarray(self.bf16)}
        if self.budget_at is not None:
            arrays["budget_at"] = np.asarray(self.budget_at)
        for number, (kernel, bias) in enumerate(self.layers):
            arrays |= {f"kernel_{number}": kernel, f"bias_{number}": bias}
        with Path(path).open("wb") as file:  # NumPy would add .npz to another suffix
            np.savez(file, allow_pickle=False, **arrays)

    @classmethod
    def load(cls, path: str | Path) -> "NumpyPolicy":
        """Return the policy that `save` wrote to `path`.

        Raises:
            ValueError: the file does not contain such a policy.
            OSError: the file cannot be read.
        """
        try:
            with np.load(path, allow_pickle=False) as stored:
                count = max(1, sum(name.startswith("kernel") for name in stored))
                layers = tuple((stored[f"kernel_{number}"], stored[f"bias_{number}"]) for number in range(count))
                budget_at = int(stored["budget_at"]) if "budget_at" in stored else None
                return cls(layers, int(stored["action_size"]), budget_at, bool(stored["bf16"]))
        except OSError:
            raise
        except Exception as error:  # damage makes zipfile and NumPy raise errors of many types
            remedy = "of a run: earl_jax.load(RUN).policy().numpy().save(FILE)"
            raise ValueError(f"{path} was not written by NumpyPolicy.save, or is damaged; {remedy}") from error


def _bf16(x: np.ndarray) -> np.ndarray:
    """Return float32 `x` rounded to the nearest bfloat16, ties to even."""
    bits = np.asarray(x, np.float32).view(np.uint32)
    return ((bits + 0x7FFF + ((bits >> 16) & 1)) & np.uint32(0xFFFF0000)).view(np.float32)
