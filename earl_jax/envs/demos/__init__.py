"""Demonstrations: recorded from the scripts of tasks, or imported from recordings of the original benchmark."""

from earl_jax.envs.demos.importer import read as read
from earl_jax.envs.demos.scripted import make as make, record as record, save as save, stacked as stacked
