"""Compiler options of the tests: most of the suite's time is compilation, and its programs run for seconds."""

from importlib.metadata import version

LEVEL_1 = {"xla_backend_optimization_level": 1}
"""40 % less time than the default. Level 0 takes less still, but with jaxlib 0.10 several programs compute NaN then."""
IS_JAXLIB_0_10 = version("jaxlib").startswith("0.10.")
OPTIONS = {**LEVEL_1, "xla_cpu_use_fusion_emitters": False} if IS_JAXLIB_0_10 else LEVEL_1
"""The second option saves another third. Only jaxlib 0.10 knows it; an unknown flag ends the process."""
DEFAULT_CODEGEN = {"xla_cpu_use_fusion_emitters": True} if IS_JAXLIB_0_10 else {}
"""The code generator that users have, for a test that expects equal bits from two programs."""


def xla_flags(inherited: str) -> str:
    """Return XLA_FLAGS with the options added once: a worker inherits the flags of the process that starts it."""
    added = [f"--{option}={str(value).lower()}" for option, value in OPTIONS.items()]
    return " ".join(dict.fromkeys([*inherited.split(), *added]))
