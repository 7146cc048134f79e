"""The command line: `earl-jax`, or `python -m earl_jax.cli`."""

import sys

try:
    from earl_jax.cli.main import main
except KeyboardInterrupt:  # Ctrl-C before there is a `main` that prints its line
    print("earl-jax: interrupted", file=sys.stderr)
    raise SystemExit(130) from None

__all__ = ["main"]
