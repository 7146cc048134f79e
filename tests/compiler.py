"""Compiler options of the tests: most of the suite's time is compilation, and its programs run for seconds."""

from importlib.metadata import version

FAST_TO_COMPILE = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_enable_concurrency_optimized_scheduler": False,
    "xla_cpu_use_fusion_emitters": False,
}
"""Less than half the time of the default options, with jaxlib 0.10.

At level 0 its concurrency-optimized scheduler makes VaPRL's program compute NaN, so that scheduler is off.
"""
LEVEL_1 = {"xla_backend_optimization_level": 1}
"""What every release of jaxlib knows; an unknown flag ends the process."""
IS_JAXLIB_0_10 = version("jaxlib").startswith("0.10.")

EQUAL_BITS = LEVEL_1 if IS_JAXLIB_0_10 else {}
"""For a test that expects equal bits from two programs: level 0 rounds differently in different programs."""
USER_OPTIONS = {
    "xla_backend_optimization_level": 3,
    "xla_cpu_enable_concurrency_optimized_scheduler": True,
    "xla_cpu_use_fusion_emitters": True,
}
DEFAULT_CODEGEN = USER_OPTIONS if IS_JAXLIB_0_10 else {}
"""The options that users have, by default."""


def xla_flags(inherited: str) -> str:
    """Return XLA_FLAGS with the fast options added once: a worker inherits the flags of the process that starts it."""
    options = FAST_TO_COMPILE if IS_JAXLIB_0_10 else LEVEL_1
    added = [f"--{option}={str(value).lower()}" for option, value in options.items()]
    return " ".join(dict.fromkeys([*inherited.split(), *added]))
