"""Programs that the tests store are compressed quickly, and JAX reads them."""

import functools
import zlib

import pytest

from tests import stored_programs

cache = stored_programs.compilation_cache
QUICK = isinstance(getattr(cache, "compress_executable", None), functools.partial)


@pytest.mark.skipif(not QUICK, reason="this release of JAX compresses programs with zstd, or keeps it elsewhere")
def test_a_program_is_stored_at_the_quick_level_and_read_by_jax():
    program = b"instruction " * 1000
    stored = cache.compress_executable(program)
    assert stored == zlib.compress(program, stored_programs.LEVEL)
    assert cache.decompress_executable(stored) == program
