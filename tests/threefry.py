"""JAX's random hash as a host call: in the programs of the tests, XLA's version takes half of the time of compilation.

XLA compiles a loop and several kernels for each of the 24 random draws of a training step. A host call needs none of
them, and NumPy computes the same bits, because the hash (Threefry-2x32, Salmon et al. 2011) is integer arithmetic. Each
call takes 0.02 ms or more, so tests with thousands of steps are `compiled`, as are those that start a process of their own.
"""

import contextlib
import ctypes

import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters import mlir

from earl_jax.physics.host_call import xla_ffi

try:
    from jax._src.random import threefry2x32 as jax_threefry
except ImportError:  # another release keeps it elsewhere, and the tests compile it
    jax_threefry = None

TARGET = "tests.threefry2x32"
SHIFTS = [[(np.uint32(left), np.uint32(32 - left)) for left in row] for row in ((13, 15, 26, 6), (17, 29, 16, 24))]
"""The rotations of the even and of the odd blocks, as a shift to the left and one to the right."""
FEW = 96
"""Up to so many words, as in most calls, operations on long integers take less time than NumPy's: a fifth for two words."""
PLAIN_SHIFTS = [[(int(left), int(right)) for left, right in row] for row in SHIFTS]
PARITY = np.uint32(0x1BD11BDA)


def threefry(key1, key2, count1, count2):
    """Return the hash of `count1, count2` with the key `key1, key2`: uint32 arrays of one shape, of NumPy or JAX.

    The assignments work in place on NumPy's arrays, which takes two thirds of the time.
    """
    words = (key1, key2, key1 ^ key2 ^ PARITY)
    first, second = count1 + words[0], count2 + words[1]
    for block in range(5):
        for left, right in SHIFTS[block % 2]:
            first += second
            high = second << left
            second >>= right
            second |= high
            second ^= first
        first += words[(block + 1) % 3]
        second += words[(block + 2) % 3]
        second += np.uint32(block + 1)
    return first, second


def threefry_of_few(key1, key2, count1, count2):
    """Return what `threefry` returns for NumPy arrays, computed on integers that hold a word in every 64 bits.

    A sum or a shift of a word stays within its 64 bits, and the mask removes what left its lower half.
    """
    ones = sum(1 << 64 * place for place in range(len(key1)))
    mask, parity = 0xFFFFFFFF * ones, int(PARITY) * ones
    key1, key2, first, second = (
        int.from_bytes(words.astype("<u8").tobytes(), "little") for words in (key1, key2, count1, count2)
    )
    words = (key1, key2, key1 ^ key2 ^ parity)
    first, second = first + words[0], (second + words[1]) & mask
    for block in range(5):
        for left, right in PLAIN_SHIFTS[block % 2]:
            first = (first + second) & mask
            second = ((second << left | second >> right) & mask) ^ first
        first += words[(block + 1) % 3]
        second = (second + words[(block + 2) % 3] + (block + 1) * ones) & mask
    return [np.frombuffer((word & mask).to_bytes(8 * len(count1), "little"), "<u8") for word in (first, second)]


def install():
    """Let JAX lower its random hash to the host call on CPUs."""
    if jax_threefry is not None:
        jax.ffi.register_ffi_target(TARGET, jax.ffi.pycapsule(_HANDLER), platform="cpu")
        _lower(_call)


@contextlib.contextmanager
def compiled():
    """Let XLA compile the hash in the programs that are traced in this context."""
    if jax_threefry is not None:
        _lower(threefry)
    try:
        yield
    finally:
        install()


def _lower(function):
    rule = mlir.lower_fun(lambda *operands: function(*jnp.broadcast_arrays(*operands)), multiple_results=True)
    mlir.register_lowering(jax_threefry.threefry2x32_p, rule, platform="cpu")


def _call(*operands):
    word = jax.ShapeDtypeStruct(operands[0].shape, jnp.uint32)
    return jax.ffi.ffi_call(TARGET, [word, word])(*operands) if word.size else operands[:2]


def _serve(frame):
    operands = _words(frame.inputs)
    function = threefry_of_few if operands[0].size <= FEW else threefry
    for result, word in zip(_words(frame.outputs), function(*operands), strict=True):
        result[:] = word


def _words(buffers):
    arrays = [item.contents for item in buffers.items[: buffers.count]]
    return [xla_ffi.view(array.data, array.count, ctypes.c_uint32) for array in arrays]


_HANDLER = xla_ffi.handler(_serve)
