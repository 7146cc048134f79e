"""Entry point of `python -m earl_jax.cli`."""

from earl_jax.cli.main import main

main()
