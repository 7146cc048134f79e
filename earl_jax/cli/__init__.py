"""The command line: `earl-jax`, or `python -m earl_jax.cli`."""

from earl_jax.cli.main import main

__all__ = ["main"]
