"""The XLA flags that help on a GPU according to measurements, set for commands that train."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence

from earl_jax.errors import InputError
from earl_jax.options.environment import PYTHON
from earl_jax.sweeps.slots import cuda_plugin

VARIABLE = "XLA_FLAGS"
FLAGS = {
    "xla_gpu_graph_enable_concurrent_region": "true",
    "xla_gpu_enable_command_buffer": "+WHILE,+CONDITIONAL",
}
"""Values by name. The first flag lets kernels of a CUDA graph run at the same time. The second makes one graph of a
whole chunk of steps if the device simulates the task. Measured on an H200 with five lanes of tabletop
(docs/performance.md)."""
TRIAL = "import jaxlib.xla_client as xla; xla.make_cpu_client()"
"""Code that makes XLA read its flags, in half a second. jax[cuda13] pins the CUDA plugin to the version of jaxlib."""
COMMANDS = ("train", "resume", "sweep", "search", "reproduce", "quickstart")
HELP = {"-h", "--help"}


def set_flags(arguments: Sequence[str]) -> None:
    """Set the flags for the command `arguments` if it trains and jax has a CUDA plugin, and print them to stderr.

    Flags that XLA_FLAGS contains already keep their values. A flag that the installed XLA does not know is not set,
    because XLA ends a process for it.

    Raises:
        ValueError: XLA refuses the value of XLA_FLAGS.
    """
    if not trains(arguments):
        return
    given = os.environ.get(VARIABLE, "")
    if given and "jax" not in sys.modules and (reason := refusal(given)) is not None:  # with jax, XLA has accepted them
        raise InputError(f"XLA refuses {VARIABLE}={given}: {reason}")
    added = helpful_flags(os.environ)
    if added:
        os.environ[VARIABLE] = " ".join([*given.split(), *added])
        print(f"earl-jax: XLA_FLAGS has {' '.join(added)}; a value of your own in XLA_FLAGS is kept", file=sys.stderr)


def trains(arguments: Sequence[str]) -> bool:
    """Return whether the command `arguments` trains."""
    return bool(arguments) and arguments[0] in COMMANDS and not HELP & set(arguments)


def helpful_flags(environment: Mapping[str, str]) -> list[str]:
    """Return the flags to add to XLA_FLAGS in `environment`, as `--name=value`; none without jax's CUDA plugin."""
    given, platforms = environment.get(VARIABLE, "").split(), environment.get("JAX_PLATFORMS", "")
    names_file = given and not given[0].startswith("-")  # XLA_FLAGS can also name a file of flags
    if names_file or platforms == "cpu" or cuda_plugin() is None:
        return []
    names = {flag.lstrip("-").partition("=")[0] for flag in given}
    added = [f"--{name}={value}" for name, value in FLAGS.items() if name not in names]
    if added and refusal(" ".join(added)) is not None:
        added = [flag for flag in added if refusal(flag) is None]
    return added


def refusal(flags: str) -> str | None:
    """Return the reason for which XLA ends a process with `flags`, or None if it accepts them."""
    try:
        trial = subprocess.run(
            [*PYTHON, "-c", TRIAL], env={**os.environ, VARIABLE: flags}, capture_output=True, text=True, check=False
        )
    except OSError:
        return None  # this process may start no other one
    return trial.stderr.partition("\n")[0].rpartition("] ")[2] if trial.returncode else None
