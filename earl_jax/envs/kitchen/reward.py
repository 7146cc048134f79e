"""The kitchen's rewards, and where hand and handles are for given joints: arithmetic on arrays, no simulation."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.physics import load_model

MODEL = "franka_kitchen"
ROBOT = 9
"""Numbers of arm and fingers at the head of a state."""
COMPONENTS = ((9, 10), (11, 12), (13, 14), (15, 16), (17, 18), (19,), (20, 21), (22,))
"""Places in a state of burners 0 to 3 (knob, plate), light (switch, block), slide, hinges (left, right) and microwave."""
SITES = ("knob1", "knob2", "knob3", "knob4", "switch", "slide", "right_door", "micro")
"""What the hand is to come to for each of them, by the MJCF's names."""
JOINT = np.array([*range(9), 9, 9, 10, 10, 11, 11, 12, 12, 13, 13, 14, 15, 16, 17])
GEAR = np.array([*[1.0] * 9, *[1.0, 1 / 174] * 4, 1.0, 1 / 14, *[1.0] * 4], np.float32)
"""Where each number of a state comes from: a joint of the MJCF and a factor, for plates and light block are slaved."""
FIRST = np.array([*range(9), 9, 11, 13, 15, 17, 19, 20, 21, 22])
"""Where each joint of the MJCF stands in a state."""
MEMBERS = np.array([[place in component for place in range(9, 23)] for component in COMPONENTS], np.float32)
TOLERANCE = 0.01 * MEMBERS.sum(axis=1)


class Link(NamedTuple):
    """A body on the way from the world to a site: its frame in its parent and, where it has one, its joint."""

    pos: np.ndarray
    turn: np.ndarray
    joint: int | None
    slides: bool
    axis: np.ndarray


def observed(qpos: Any) -> Any:
    """Return the state [..., 23] without noise at the MJCF's joints `qpos [..., 18]`: plates and light block follow."""
    return qpos[..., JOINT] * GEAR


def site_places(state: jax.Array) -> jax.Array:
    """Return where the handles `SITES` are [8, 3], in metres, for the object numbers of `state [23]`."""
    return jnp.stack([_place(state[FIRST], *_chain(site)) for site in SITES])


def dragging_place(state: jax.Array) -> jax.Array:
    """Return where the mocap body [3] would be if the flange stood exactly where it drags it, in metres, for `state [23]`."""
    flange = _place(state[FIRST], *_chain("tip")[:1], np.zeros(3))
    return flange - jnp.asarray(_dragged_at(), jnp.float32)


def released(obs: jax.Array, mocap: jax.Array, sites: jax.Array) -> jax.Array:
    """Return the released dense reward [] of `obs [46]` with the mocap body at `mocap [3]` and handles at `sites [8, 3]`.

    -10 times the distance of the 14 object numbers to their goals, +1 for each of the 8 components within 0.01 a number, and
    -0.5 times the metres from the mocap body to the handle of the first that is not. At most 8.
    """
    objects = obs[ROBOT:23] - obs[23 + ROBOT :]
    done = _by_component(objects) < TOLERANCE
    reach = jnp.linalg.norm(mocap - sites[jnp.argmin(done)])
    return -10.0 * jnp.linalg.norm(objects) + done.sum() - jnp.where(done.all(), 0.0, 0.5 * reach)


def published(obs: jax.Array) -> jax.Array:
    """Return the reward [] of `obs [46]` as the paper's text has it.

    The text: the arm's Euclidean distance to its goal and a shaped reward per object. Read here as minus the distance of the 9
    robot numbers to theirs, minus that of each of the 8 components to its own, +1 for each within its tolerance.
    """
    error = obs[:23] - obs[23:]
    objects = _by_component(error[ROBOT:])
    return -jnp.linalg.norm(error[:ROBOT]) - objects.sum() + (objects < TOLERANCE).sum()


def _by_component(objects: jax.Array) -> jax.Array:
    """Return the norm [8] of each component's part of `objects [14]`."""
    return jnp.linalg.norm(MEMBERS * objects, axis=1)


@functools.cache
def _chain(site: str) -> tuple[tuple[Link, ...], np.ndarray]:
    """Return the bodies from the world to `site` and its place in the last of them."""
    model = load_model(MODEL)
    index, links = model.site(site).bodyid[0], []
    while index:
        body, address = model.body(index), model.body_jntadr[index]
        joint = model.joint(address) if address >= 0 else None
        axis = np.zeros(3) if joint is None else joint.axis.copy()
        slides = joint is not None and joint.type[0] == 2
        number = None if joint is None else int(joint.qposadr[0])
        links.append(Link(body.pos.copy(), _matrix(body.quat), number, slides, axis))
        index = body.parentid[0]
    return tuple(links[::-1]), model.site(site).pos.copy()


@functools.cache
def _dragged_at() -> np.ndarray:
    """Return where the flange stands [3], seen from the mocap body, when the weld is content."""
    model = load_model(MODEL)
    return _matrix(model.body("mocap").quat) @ model.equality("drag").data[3:6]


def _place(qpos: jax.Array, links: tuple[Link, ...], end: np.ndarray) -> jax.Array:
    """Return where the point `end [3]` of the last of `links` is in the world, [3], at joints `qpos [18]`."""
    point = jnp.asarray(end, jnp.float32)
    for link in reversed(links):
        if link.joint is not None:
            value = qpos[link.joint]
            point = point + value * link.axis if link.slides else _turned(point, link.axis, value)
        point = jnp.asarray(link.turn, jnp.float32) @ point + link.pos
    return point


def _turned(point: jax.Array, axis: np.ndarray, angle: jax.Array) -> jax.Array:
    """Return `point [3]` turned by `angle` about the unit vector `axis [3]`: Rodrigues' formula."""
    along = jnp.dot(point, axis) * axis
    return along + jnp.cos(angle) * (point - along) + jnp.sin(angle) * jnp.cross(jnp.asarray(axis, jnp.float32), point)


def _matrix(quat: np.ndarray) -> np.ndarray:
    """Return the rotation [3, 3] of a unit quaternion w, x, y, z."""
    w, v = quat[0], quat[1:]
    cross = np.cross(np.eye(3), v)
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross
