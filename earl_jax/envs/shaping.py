"""Shaping functions of dm_control and Meta-World for dense rewards; they broadcast and return values in [0, 1]."""

import jax
import jax.numpy as jnp

VALUE_AT_MARGIN = 0.1


def gaussian(x: jax.Array) -> jax.Array:
    """Return a Gaussian bell of `x` that is 1 at 0 and 0.1 at 1."""
    return jnp.exp(jnp.log(VALUE_AT_MARGIN) * x**2)


def long_tail(x: jax.Array) -> jax.Array:
    """Return a Cauchy curve of `x` that is 1 at 0 and 0.1 at 1."""
    return 1.0 / (1.0 + (1.0 / VALUE_AT_MARGIN - 1.0) * x**2)


def linear(x: jax.Array) -> jax.Array:
    """Return a ramp of `x` that is 1 at 0 and 0 from 1 on: dm_control's linear sigmoid with value 0 at the margin."""
    return jnp.maximum(1.0 - x, 0.0)


def tolerance(x: jax.Array, low: float, high: jax.Array | float, margin: jax.Array, sigmoid=gaussian) -> jax.Array:
    """Return 1 for `x` in [low, high], falling to 0.1 (`linear`: 0) at a distance of `margin`; a margin of 0 is a step.

    Source: dm_control, `rewards.tolerance`.
    """
    outside = jnp.maximum(low - x, x - high)
    scaled = outside / jnp.where(margin > 0, margin, 1.0)
    return jnp.where(outside <= 0, 1.0, jnp.where(margin > 0, sigmoid(scaled), 0.0))


def hamacher(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return the Hamacher product of `a` and `b` in [0, 1]: a soft "and". Source: Meta-World, `reward_utils`."""
    below = a + b - a * b
    return jnp.where(below > 0, a * b / jnp.where(below > 0, below, 1.0), 0.0)


def prism(x: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """Return the product of three ramps from corner `low` to corner `high` for `x [..., 3]` in the box, and 1 outside.

    Source: Meta-World, `reward_utils.rect_prism_tolerance`.
    """
    ramps = (x - low) / (high - low)
    within = ((ramps >= 0) & (ramps <= 1)).all(axis=-1)
    return jnp.where(within, ramps.prod(axis=-1), 1.0)
