"""Why jax does not start, which its variables decide."""

import os


def start_failure(error: Exception) -> str | None:
    """Return `error` as one line with jax's variables if jax cannot be imported or has no device, else None."""
    given = ", ".join(f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith("JAX_"))
    try:
        import jax

        jax.jit(lambda: 0)()
    except Exception:
        cause = " ".join(str(error).split()) or "it finds no device"
        return f"jax does not start with {given}: {cause}; correct or unset the variable" if given else None
    return None
