"""The flags of XLA that were measured to help on a GPU, set for commands that train."""

import mmap
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.options.environment import PYTHON
from earl_jax.sweeps.slots import cuda_plugin

VARIABLE = "XLA_FLAGS"
FLAGS = {
    "xla_gpu_graph_enable_concurrent_region": ("true", ""),
    "xla_gpu_enable_command_buffer": ("+WHILE,+CONDITIONAL", "command types with + and - as prefix"),
}
"""Values by name, each with a text of XLA's table of flags without which the value is not understood. The first flag lets
kernels of a CUDA graph run at the same time; the second makes one graph of a whole chunk of steps of a task that the device
simulates. Measured on an H200, five lanes of tabletop, in docs/performance.md."""
TRIAL = "import jaxlib.xla_client as xla; xla.make_cpu_client()"
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
    if os.environ.get(VARIABLE) and "jax" not in sys.modules:  # else XLA has accepted them
        _try_flags()
    added = helpful_flags(os.environ)
    if added:
        os.environ[VARIABLE] = " ".join([*os.environ.get(VARIABLE, "").split(), *added])
        print(f"earl-jax: XLA_FLAGS has {' '.join(added)}; a value of your own in XLA_FLAGS is kept", file=sys.stderr)


def trains(arguments: Sequence[str]) -> bool:
    """Return whether the command `arguments` trains."""
    return bool(arguments) and arguments[0] in COMMANDS and not HELP & set(arguments)


def _try_flags() -> None:
    """Raise an InputError with XLA's reason if it ends another process for the flags of this one."""
    try:
        trial = subprocess.run([*PYTHON, "-c", TRIAL], capture_output=True, text=True, check=False)
    except OSError:
        return  # this process may start no other one
    if trial.returncode:
        reason = trial.stderr.partition("\n")[0].rpartition("] ")[2]
        raise InputError(f"XLA refuses {VARIABLE}={os.environ[VARIABLE]}: {reason}")


def helpful_flags(environment: Mapping[str, str]) -> list[str]:
    """Return the flags to add to XLA_FLAGS of `environment`, as `--name=value`; none without jax's CUDA plugin."""
    given, platforms = environment.get(VARIABLE, "").split(), environment.get("JAX_PLATFORMS", "")
    if (given and not given[0].startswith("-")) or platforms == "cpu":  # XLA_FLAGS can also name a file of flags
        return []
    plugin, jaxlib = cuda_plugin(), find_spec("jaxlib")
    if plugin is None or jaxlib is None or jaxlib.origin is None:
        return []
    names = {flag.lstrip("-").partition("=")[0] for flag in given}
    folders = (Path(jaxlib.origin).parent, plugin)
    return [
        f"--{name}={value}"
        for name, (value, text) in FLAGS.items()
        if name not in names and all(knows_flag(folder, name, text) for folder in folders)
    ]


def knows_flag(folder: Path, name: str, text: str) -> bool:
    """Return whether a library in `folder` contains `text`, and `name` as XLA's table of flags does, before a zero byte.

    It takes milliseconds: the table is near the beginning of the file. The name of an option that is no flag any more
    can remain in descriptions of messages, where no zero byte follows.
    """
    libraries = sorted(folder.glob("*.so"), key=lambda path: path.stat().st_size, reverse=True)
    return any(_contains(path, name.encode() + b"\0", text.encode()) for path in libraries if path.stat().st_size)


def _contains(path: Path, *texts: bytes) -> bool:
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return all(content.find(text) >= 0 for text in texts)
