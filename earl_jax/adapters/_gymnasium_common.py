"""What the single and the vector environment of gymnasium share: metadata, infos, seeds."""

from typing import Any

import gymnasium
import numpy as np

from earl_jax.adapters._session import Session
from earl_jax.adapters._session_state import SessionState, StepResult
from earl_jax.envs import Env
from earl_jax.errors import InputError

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}


def metadata(env: Env, render_mode: str | None) -> dict[str, Any]:
    """Return gymnasium's metadata of `env`.

    Raises:
        ValueError: the render mode is unknown; the message lists the choices.
    """
    modes = METADATA["render_modes"]
    if render_mode not in (None, *modes):
        raise InputError(f"render_mode {render_mode!r} is not one of None, {', '.join(modes)}")
    return {"render_modes": modes, "render_fps": round(1 / env.step_seconds)}


def infos(session: Session, result: StepResult) -> dict[str, np.ndarray]:
    """Return the infos of one lane, or of all with a leading axis."""
    values = {
        "goal": np.array(result.obs[..., session.env.state_size :]),
        "success": np.array(result.success),
        "interventions": np.array(result.interventions, np.int64),
    }
    if not session.is_training:
        values["is_success"] = np.array(result.reached)
    if session.starts == "wide":
        values["is_success_wide"] = np.array(result.reached)
    return values


def require_reset(state: SessionState | None) -> SessionState:
    """Return `state`, which the first `reset` sets.

    Raises:
        gymnasium.error.ResetNeeded: there was no reset yet.
    """
    if state is None:
        raise gymnasium.error.ResetNeeded("call reset() first")
    return state


def draw_seed(generator: np.random.Generator) -> np.uint32:
    """Return a seed of a session, drawn from gymnasium's generator."""
    return generator.integers(2**32, dtype=np.uint32)
