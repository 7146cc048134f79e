"""The command line: `earl-jax`, also as `python -m earl_jax.cli`."""
