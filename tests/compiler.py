"""Compiler options of the tests: most of the suite's time is compilation, and its programs run for seconds."""

import platform
from importlib.metadata import version

IS_JAXLIB_0_10 = version("jaxlib").startswith("0.10.")
IS_X86 = platform.machine().lower() in ("x86_64", "amd64")
LEVEL_1 = {"xla_backend_optimization_level": 1}
NO_EMITTERS = {**LEVEL_1, "xla_cpu_use_fusion_emitters": False}
LEVEL_0 = {
    "xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False, "xla_cpu_max_isa": "AVX",
    "xla_cpu_parallel_codegen_split_count": 1,
    "xla_disable_hlo_passes": "while-loop-invariant-code-motion,while-loop-constant-sinking",
}  # fmt: skip
"""Half the time of `NO_EMITTERS`, which takes 40 % of the default's. At level 0 several programs compute NaN with the
instructions of AVX2, none with those of AVX. One LLVM module takes less time than the default's 32. The two passes over
loops take a tenth of the rest, because all other simplifications run again after every one of their rounds."""
OPTIONS = (LEVEL_0 if IS_X86 else NO_EMITTERS) if IS_JAXLIB_0_10 else LEVEL_1
"""Only jaxlib 0.10 is known to have the options beside the level; an unknown flag ends the process."""
EQUAL_BITS = {**LEVEL_1, "xla_cpu_use_fusion_emitters": True} if IS_JAXLIB_0_10 and not IS_X86 else {}
"""For a test that expects equal bits from programs of different numbers of lanes: `NO_EMITTERS` may give others."""


def xla_flags(inherited: str) -> str:
    """Return XLA_FLAGS with the options added once: a worker inherits the flags of the process that starts it."""
    added = [f"--{option}={str(value).lower()}" for option, value in OPTIONS.items()]
    return " ".join(dict.fromkeys([*inherited.split(), *added]))
