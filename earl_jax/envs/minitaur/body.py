"""The randomised parameters of the Minitaur's body: masses, inertias and the friction of its feet.

Source: the randomiser that the released EARL code enables. It scales the masses of chassis, motors and lower legs. Here
the upper legs are fused with their motors and are scaled with them.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.physics import load_model

VARIED = ("body_mass", "body_inertia", "body_subtreemass", "pair_friction")
MASSES = (0.8, 1.2)
"""Range of the factors on the masses of the chassis, the motors and the lower legs, one factor each."""
KINDS = ("base", "motor", "lower")
FRICTIONS = (0.8, 1.5)


def draw(key: jax.Array, name: str) -> jax.Array:
    """Return random values [k] of the fields `VARIED` of the model `name`, flattened in that order."""
    model = load_model(name)
    names = [model.body(number).name for number in range(model.nbody)]
    kind = np.array([next((n for n, kind in enumerate(KINDS) if own.startswith(kind)), 0) for own in names])
    mass, inertia, pair_friction = (
        np.asarray(values, np.float32) for values in (model.body_mass, model.body_inertia, model.pair_friction)
    )
    mass_key, friction_key = jax.random.split(key)
    factor = jax.random.uniform(mass_key, (len(KINDS),), minval=MASSES[0], maxval=MASSES[1])[kind]
    friction = jax.random.uniform(friction_key, minval=FRICTIONS[0], maxval=FRICTIONS[1])
    fields = {
        "body_mass": factor * mass,
        "body_inertia": factor[:, None] * inertia,
        "body_subtreemass": (_carried(model) * (factor * mass)).sum(axis=1),
        "pair_friction": jnp.where(_slides(model), friction, pair_friction),
    }
    return jnp.concatenate([jnp.ravel(fields[field]) for field in VARIED])


def _carried(model: Any) -> np.ndarray:
    """Return a float32 matrix [B, B] whose row i marks the bodies in the subtree of body i."""
    carried = np.eye(model.nbody, dtype=np.float32)
    for body in range(model.nbody - 1, 0, -1):
        carried[model.body_parentid[body]] += carried[body]
    return carried


def _slides(model: Any) -> np.ndarray:
    """Return which numbers of `pair_friction [P, 5]` are a foot's sliding friction on the floor, bool [P, 5]."""
    foot = [model.geom(int(geom)).name.startswith("foot_") for geom in model.pair_geom2]
    on_floor = model.pair_geom1 == model.geom("floor").id
    return (np.array(foot) & on_floor)[:, None] & (np.arange(5) < 2)
