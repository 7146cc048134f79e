"""Demonstrations: recorded from the scripts that tasks bring, or imported from recordings of the original benchmark."""

from earl_jax.envs.demos.importer import read
from earl_jax.envs.demos.scripted import make, record, save, stacked

__all__ = ["make", "read", "record", "save", "stacked"]
