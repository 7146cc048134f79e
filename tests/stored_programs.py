"""Quick compression of the programs that the tests store: zlib's default takes three times as long for 15 % fewer bytes.

JAX takes zlib where no package of zstd is installed, and reads what any level wrote.
"""

import functools
import zlib

try:
    from jax._src import compilation_cache
except ImportError:  # another release keeps it elsewhere, and compresses as it does for users
    compilation_cache = None

LEVEL = 1


def install():
    """Let JAX compress the programs that it stores at zlib's level 1, if it compresses them with zlib."""
    if getattr(compilation_cache, "zlib", None) is zlib and not _has_zstd():
        compilation_cache.compress_executable = functools.partial(zlib.compress, level=LEVEL)


def _has_zstd():
    return any(getattr(compilation_cache, name, None) for name in ("zstd", "zstandard"))
