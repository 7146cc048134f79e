"""The kitchen's variants with log standard deviations up to 10, as the release clips them."""

from benchmarks.paper import kitchen_variants
from earl_jax.algos.learner import networks

networks.LOG_STD_RANGE = (-20.0, 10.0)
__all__ = ["kitchen_variants"]
