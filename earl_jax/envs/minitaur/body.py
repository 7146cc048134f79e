"""The randomised parameters of the Minitaur's body: masses, inertias and the friction of its feet.

Source: the randomiser that the released EARL code enables. It scales the masses of chassis, motors and lower legs. Here
the upper legs are fused with their motors and are scaled with them.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.physics import load_model

VARIED = ("body_mass", "body_inertia", "body_subtreemass", "pair_friction")
MASSES = (0.8, 1.2)
"""Range of the factors on the masses of the chassis, the motors and the lower legs, one factor each."""
KINDS = ("base", "motor", "lower")
FRICTIONS = (0.8, 1.5)


class Body(NamedTuple):
    """The nominal robot with B bodies and P contact pairs.

    `kind [B]` indexes `KINDS`. `mass [B]` and `inertia [B, 3]` are the bodies' own. `carried [B, B]`: row i marks the
    bodies in the subtree of body i. `friction [P, 5]` belongs to the contact pairs, and `slides [P, 5]` marks the
    entries that are a foot's sliding friction on the floor.
    """

    kind: np.ndarray
    mass: np.ndarray
    inertia: np.ndarray
    carried: np.ndarray
    friction: np.ndarray
    slides: np.ndarray


@functools.cache
def nominal(name: str) -> Body:
    """Return the compiled parameters of the robot in the model `name`."""
    model = load_model(name)
    kinds = [
        next((n for n, kind in enumerate(KINDS) if model.body(i).name.startswith(kind)), 0) for i in range(model.nbody)
    ]
    carried = np.eye(model.nbody, dtype=np.float32)
    for body in range(model.nbody - 1, 0, -1):
        carried[model.body_parentid[body]] += carried[body]
    foot = [model.geom(int(geom)).name.startswith("foot_") for geom in model.pair_geom2]
    on_floor = model.pair_geom1 == model.geom("floor").id
    slides = (np.array(foot) & on_floor)[:, None] & (np.arange(5) < 2)
    mass, inertia, friction = (
        np.asarray(a, np.float32) for a in (model.body_mass, model.body_inertia, model.pair_friction)
    )
    return Body(np.array(kinds), mass, inertia, carried, friction, slides)


def draw(key: jax.Array, name: str) -> jax.Array:
    """Return random values [k] of the fields `VARIED` of the model `name`, flat and in that order."""
    body = nominal(name)
    mass_key, friction_key = jax.random.split(key)
    factor = jax.random.uniform(mass_key, (len(KINDS),), minval=MASSES[0], maxval=MASSES[1])[body.kind]
    friction = jax.random.uniform(friction_key, minval=FRICTIONS[0], maxval=FRICTIONS[1])
    mass = factor * body.mass
    fields = {
        "body_mass": mass,
        "body_inertia": factor[:, None] * body.inertia,
        "body_subtreemass": (body.carried * mass).sum(axis=1),
        "pair_friction": jnp.where(body.slides, friction, body.friction),
    }
    return jnp.concatenate([jnp.ravel(fields[field]) for field in VARIED])
