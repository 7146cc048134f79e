"""The kitchen's rewards, and the positions of hand and handles for given joints, computed without simulation."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from earl_jax.physics import load_model

MODEL = "franka_kitchen"
ROBOT = 9
"""Length of the first part of a state: arm and fingers."""
COMPONENTS = ((9, 10), (11, 12), (13, 14), (15, 16), (17, 18), (19,), (20, 21), (22,))
"""Indices into a state of burners 0 to 3 (knob, plate), light (switch, block), slide, hinges (left, right) and
microwave."""
SITES = ("knob1", "knob2", "knob3", "knob4", "switch", "slide", "right_door", "micro")
"""Names of sites in the MJCF: the handle of each component, which the hand approaches."""
JOINT = np.array([*range(9), 9, 9, 10, 10, 11, 11, 12, 12, 13, 13, 14, 15, 16, 17])
GEAR = np.array([*[1.0] * 9, *[1.0, 1 / 174] * 4, 1.0, 1 / 14, *[1.0] * 4], np.float32)
"""A state is `qpos[JOINT] * GEAR`: plates and light block have no joints of their own and follow knobs and switch."""
FIRST = np.unique(JOINT, return_index=True)[1]
"""Index of each joint of the MJCF in a state."""
MEMBERS = np.array([[index in component for index in range(9, 23)] for component in COMPONENTS], np.float32)
TOLERANCE = 0.01 * MEMBERS.sum(axis=1)
SLIDE = 2
"""MuJoCo's type of a slide joint."""


def observed(qpos: Any) -> Any:
    """Return the state [..., 23] without noise for the MJCF's joints `qpos [..., 18]`."""
    return qpos[..., JOINT] * GEAR


def site_positions(state: jax.Array) -> jax.Array:
    """Return the positions [8, 3] of the handles `SITES`, in metres, for the object numbers of `state [23]`."""
    sites = [load_model(MODEL).site(name) for name in SITES]
    return jnp.stack([_point_position(state[FIRST], site.bodyid[0], site.pos) for site in sites])


def dragging_position(state: jax.Array) -> jax.Array:
    """Return the position [3], in metres, of the mocap body whose weld holds the flange in the pose of `state [23]`."""
    model = load_model(MODEL)
    flange = _point_position(state[FIRST], model.site("tip").bodyid[0], np.zeros(3))
    held = Rotation.from_quat(model.body("mocap").quat, scalar_first=True)
    without_force = held.apply(model.equality("drag").data[3:6])
    return flange - jnp.asarray(without_force, jnp.float32)


def released(obs: jax.Array, mocap: jax.Array, sites: jax.Array) -> jax.Array:
    """Return the released dense reward [] of `obs [46]` with the mocap body at `mocap [3]`, handles at `sites [8, 3]`.

    It is the sum of three terms, at most 8: -10 times the distance of the 14 object numbers to their goals; +1 for each
    of the 8 components within 0.01 per number; -0.5 per metre from the mocap body to the handle of the first one that
    is not.
    """
    objects = obs[ROBOT:23] - obs[23 + ROBOT :]
    done = _by_component(objects) < TOLERANCE
    reach = jnp.linalg.norm(mocap - sites[jnp.argmin(done)])
    return -10.0 * jnp.linalg.norm(objects) + done.sum() - jnp.where(done.all(), 0.0, 0.5 * reach)


def published(obs: jax.Array) -> jax.Array:
    """Return the reward [] of `obs [46]` that the paper's text describes.

    The text names the arm's Euclidean distance to its goal and a shaped reward for each object. We read this as minus
    the distance of the 9 robot numbers to their goals, minus the distance of each of the 8 components to its goal, plus
    1 for each component within its tolerance.
    """
    error = obs[:23] - obs[23:]
    objects = _by_component(error[ROBOT:])
    return -jnp.linalg.norm(error[:ROBOT]) - objects.sum() + (objects < TOLERANCE).sum()


def _by_component(objects: jax.Array) -> jax.Array:
    """Return the norm [8] of the part of `objects [14]` that belongs to each component."""
    return jnp.linalg.norm(MEMBERS * objects, axis=1)


def _point_position(qpos: jax.Array, body: int, end: np.ndarray) -> jax.Array:
    """Return the world position [3] of `end [3]` in the frame of the body with this number, at joints `qpos [18]`.

    The coordinates are separate scalars with a barrier at each joint: a GPU then needs one kernel for each body instead
    of three for products of matrices, and without barriers XLA would recompute each body for every later one.
    """
    model, point = load_model(MODEL), tuple(end.tolist())
    while body:
        joint = model.body_jntadr[body]
        if joint >= 0:
            value, axis = qpos[int(model.jnt_qposadr[joint])], model.jnt_axis[joint].tolist()
            if model.jnt_type[joint] == SLIDE:
                point = tuple(x + value * along for x, along in zip(point, axis, strict=True))
            else:
                point = jax.lax.optimization_barrier(_rotated(point, axis, value))
        rotation = Rotation.from_quat(model.body_quat[body], scalar_first=True).as_matrix().tolist()
        point = tuple(_dot(row, point) + x for row, x in zip(rotation, model.body_pos[body].tolist(), strict=True))
        body = model.body_parentid[body]
    return jnp.stack([jnp.asarray(x, jnp.float32) for x in point])


def _dot(constants: Sequence[float], point: Sequence[Any]) -> Any:
    """Return the scalar product of `constants` and `point`, without the terms whose constant is 0."""
    return sum(constant * x for constant, x in zip(constants, point, strict=True) if constant)


def _rotated(point: Sequence[Any], axis: Sequence[float], angle: jax.Array) -> tuple[Any, ...]:
    """Return `point` rotated by `angle` about the unit vector `axis`, by Rodrigues' formula."""
    (x, y, z), (a, b, c) = point, axis
    cross = _dot((-c, b), (y, z)), _dot((c, -a), (x, z)), _dot((-b, a), (x, y))
    share, cosine, sine = _dot(axis, point), jnp.cos(angle), jnp.sin(angle)
    along = tuple(share * component for component in axis)
    return tuple(
        part + cosine * (coordinate - part) + sine * turned
        for coordinate, part, turned in zip(point, along, cross, strict=True)
    )
