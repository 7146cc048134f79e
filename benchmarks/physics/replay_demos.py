"""Replay recorded demonstrations open loop and print one JSON line with the errors of a Sawyer task against its original.

    python -m benchmarks.physics.replay_demos sawyer_door FILE.npz --engine mjx
    python -m benchmarks.physics.replay_demos sawyer_peg demo_data.pkl --engine c --substeps 4

Each episode starts in the state of the first observation, plays the actions and then repeats the last one for 10 steps. The arm
takes the nearer one of the task's two reset poses: the ordinary one and that of the release's `reset_at_goal`. If the recorded
hand is elsewhere, as after contact, the arm and its mocap target are moved to it. A file whose goal is not the task's own is a
backward one.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from tyro.conf import Positional

from earl_jax import physics
from earl_jax.assets import Demos, spans
from earl_jax.envs import State, chosen_engine, make
from earl_jax.envs.demos import read
from earl_jax.envs.sawyer.base import ARM, OPENING, Sawyer

HOLD = 10
ALREADY_THERE = 1e-5
"""Metres of hand position that need no correction."""


def start_state(env: Sawyer, first: np.ndarray) -> State:
    """Return the state in which a recording with the first observation `first [14]` started."""
    env = nearer_reset(env, first)
    assert env.demonstrations.state_at is not None
    state = env.demonstrations.state_at(*map(jnp.asarray, np.split(first, 2)))
    if np.abs(np.asarray(state.obs[:3]) - first[:3]).max() < ALREADY_THERE:
        return state
    target = state.data.mocap_pos + jnp.asarray(first[:3]) - state.obs[:3]
    vector = jnp.concatenate([jnp.asarray(first[:4]), state.obs[4:7]])
    data = state.data.replace(qpos=moved_hand(env, state, first), mocap_pos=target)
    return state.replace(data=data, obs=jnp.concatenate([vector, first[7:]]))


def nearer_reset(env: Sawyer, first: np.ndarray) -> Sawyer:
    """Return `env` with the value of `reset_at_goal` whose pose of the arm is nearer to that of `first [14]`."""
    choices = [
        dataclasses.replace(env, reset_at_goal=at_goal) for at_goal in (env.reset_at_goal, not env.reset_at_goal)
    ]
    return min(choices, key=lambda choice: np.linalg.norm([*choice.pose.hand, choice.pose.grip] - first[:4]))


def moved_hand(env: Sawyer, state: State, first: np.ndarray) -> jax.Array:
    """Return qpos with the hand position and finger opening of `first` and the same orientation, by damped least squares."""
    import mujoco

    model, data = physics.load_model(env.name), physics.mujoco_data(env.name, state.data)
    hand = model.body("hand").id
    upright, linear, turn = data.xquat[hand].copy(), np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for _ in range(100):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, linear, turn, hand)
        twist = np.zeros(3)
        mujoco.mju_subQuat(twist, upright, data.xquat[hand])
        error = np.concatenate([first[:3] - data.xpos[hand], data.xmat[hand].reshape(3, 3) @ twist])
        jacobian = np.vstack([linear, turn])[:, : ARM - 2]
        data.qpos[: ARM - 2] += jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(6), error)
    if first[3] < 1.0:
        data.qpos[ARM - 1] = -min(0.03, OPENING * (1.0 - first[3]))
        data.qpos[ARM - 2] = OPENING * (1.0 - first[3]) + data.qpos[ARM - 1]
    return jnp.asarray(data.qpos, jnp.float32)


def first_observation(episode: Demos) -> np.ndarray:
    """Return state and goal [14] at the start of `episode`."""
    return np.append(episode.states[0], episode.goals[0])


def play(env: Sawyer, episodes: list[Demos]) -> list[np.ndarray]:
    """Return the observations [T + 10, 14] of each episode, all of them simulated in one program."""
    longest = max(len(episode.actions) for episode in episodes) + HOLD
    actions = np.stack(
        [episode.actions[np.minimum(np.arange(longest), len(episode.actions) - 1)] for episode in episodes]
    )
    starts = [start_state(env, first_observation(episode)) for episode in episodes]
    state = jax.tree.map(lambda *leaves: jnp.stack(leaves), *starts)

    def play_episode(state: State, actions: jax.Array) -> jax.Array:
        def step(state, action):
            state = env.step(state, action)
            return state, state.obs

        return jax.lax.scan(step, state, actions)[1]

    obs = np.asarray(jax.jit(jax.vmap(play_episode))(state, jnp.asarray(actions)))
    return [part[: len(episode.actions) + HOLD] for part, episode in zip(obs, episodes, strict=True)]


def compare(env: Sawyer, episode: Demos, obs: np.ndarray) -> dict[str, Any]:
    """Return errors [T] of the object in metres, agreement [T] of rewards and the offset of the first success."""
    length = len(episode.actions)
    success = np.asarray(jax.jit(env.success)(obs))
    first = int(np.argmax(success)) if success.any() else None
    recorded = episode.rewards > 0
    ended = int(np.argmax(recorded)) if recorded.any() else length - 1
    return {
        "errors": np.linalg.norm(obs[:length, 4:7] - episode.next_states[:, 4:7], axis=1),
        "agreement": success[:length] == recorded,
        "offset": None if first is None else first - ended,
        "by_end": first is not None and first < length,
    }


def replay(name: str, file: Path, engine: str, substeps: int = 5) -> dict[str, Any]:
    """Return the report on one file of recordings."""
    demos = read(file)
    episodes = [Demos(*(field[span] for field in demos)) for span in spans(demos.ends)]
    env = make(name, engine=engine, substeps=substeps)
    if not isinstance(env, Sawyer):
        raise ValueError(f"{name} is not a Sawyer task; the tests in tests/envs replay its recordings")
    forward = bool(np.abs(demos.goals[0] - env.goal_states[0]).max() < 1e-4)
    results = [compare(env, episode, obs) for episode, obs in zip(episodes, play(env, episodes), strict=True)]
    errors = np.concatenate([result["errors"] for result in results])
    reset_error = max(_reset_error(env, first_observation(episode)) for episode in episodes)
    return {
        "env": name, "file": file.name, "engine": physics.resolve_engine(chosen_engine(env)), "substeps": substeps,
        "direction": "forward" if forward else "backward", "episodes": len(results),
        "successes_by_end": sum(result["by_end"] for result in results),
        "successes_within_hold": sum(result["offset"] is not None for result in results),
        "mean_object_error_mm": round(float(errors.mean()) * 1e3, 3),
        "worst_object_error_mm": round(float(errors.max()) * 1e3, 3),
        "reward_agreement": round(float(np.concatenate([result["agreement"] for result in results]).mean()), 4),
        "first_success_offsets": [result["offset"] for result in results],
        "reset_arm_error": reset_error,
    }  # fmt: skip


def _reset_error(env: Sawyer, first: np.ndarray) -> float:
    """Return the largest difference of hand and opening between `first [14]` and the nearer reset pose."""
    pose = nearer_reset(env, first).pose
    return float(np.abs([*pose.hand, pose.grip] - first[:4]).max())


def main(
    env: Positional[Literal["sawyer_door", "sawyer_peg"]],
    file: Positional[Path],
    engine: Literal["auto", "c", "mjx", "warp"] = "auto",
    substeps: int = 5,
):
    """Print the report on one file."""
    print(json.dumps(replay(env, file, engine, substeps)))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
