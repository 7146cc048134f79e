"""The earlier name of `earl_jax.adapters.earl_benchmark`, for scripts that import it."""

from earl_jax.adapters.earl_benchmark import EARLEnvs, PersistentEnv  # noqa: F401
