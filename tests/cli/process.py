"""The command line in its own process, with a tiny training run on which several test files rely."""

import os
import subprocess
import sys

from tests.conftest import CACHE

LENGTHS = ["--seeds", "2", "--steps", "400", "--eval-every", "40", "--eval-episodes", "2", "--checkpoint-every", "40"]
OPTIONS = ["--set", "hidden_sizes=[16,16]", "batch_size=16", "random_steps=20"]
ENVIRONMENT = {
    **os.environ,
    "JAX_PLATFORMS": "cpu",
    "JAX_COMPILATION_CACHE_DIR": str(CACHE),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
}


def start(*arguments):
    """Return the running process of one command."""
    command = [sys.executable, "-m", "earl_jax.cli", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)


def run(*arguments):
    """Return exit code, stdout and stderr of one command."""
    process = start(*arguments)
    out, err = process.communicate(timeout=300)
    return process.returncode, out, err


def train(folder, algo="fbrl"):
    """Return the arguments of a training run of 400 steps into `folder`."""
    return ["train", "tabletop_organization", "--algo", algo, "--out", folder, *LENGTHS, *OPTIONS]


def snapshot(folder):
    """Return the bytes of every file below `folder`."""
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
