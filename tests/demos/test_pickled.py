"""The reader of pickles returns what numpy would, for every file that numpy writes, and refuses the rest."""

import functools
import io
import pickle
import pickletools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from earl_jax.demos import pickled
from earl_jax.errors import InputError
from tests.demos import attack_pickles as files

FUZZ = settings(max_examples=150, deadline=None)
PROTOCOLS = range(6)
TYPES = ["?", "i1", "u1", "<i2", ">u4", "<i8", "<f2", ">f4", "<f8"]


def arrays():
    values = np.arange(24).reshape(2, 3, 4)
    shapes = {
        "matrix": values[0], "fortran": np.asfortranarray(values[0]), "strided": values[0, :, ::2],
        "row": values[0, 0], "number": np.array(7), "empty": np.zeros((0, 3)), "swapped": values.transpose(1, 0, 2),
    }  # fmt: skip
    return {f"{name} {code}": part.astype(code) for name, part in shapes.items() for code in TYPES}


class Trusted(pickle.Unpickler):
    """Python's unpickler with numpy's own classes, for files that the reader has accepted."""

    def find_class(self, module, name):
        assert f"{module} {name}" in pickled.GLOBALS
        return super().find_class(module, name)


def cut(data):
    """The opcodes of a pickle, each with its argument."""
    starts = [offset for _, _, offset in pickletools.genops(data)]
    return [data[start:stop] for start, stop in zip(starts, [*starts[1:], len(data)], strict=True)]


def assert_equal_to_numpy(data):
    ours = pickled.load(data)
    unframed = b"".join(part for part in cut(data) if not part.startswith(b"\x95"))  # frames only speed up reading
    theirs = Trusted(io.BytesIO(unframed), encoding="latin1").load()
    assert list(ours) == list(theirs)
    for name, array in ours.items():
        native = array.astype(array.dtype.newbyteorder("="))  # numpy swaps the bytes in some protocols
        assert (native.dtype, native.shape) == (theirs[name].dtype.newbyteorder("="), theirs[name].shape)
        assert native.tobytes() == theirs[name].astype(native.dtype).tobytes()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_arrays_of_every_type_and_order_are_read(protocol):
    content = arrays()
    data = pickle.dumps(content, protocol)
    assert list(pickled.load(data)) == list(content)
    assert_equal_to_numpy(data)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_an_array_under_two_names_is_read_twice(protocol):
    shared = np.ones((2, 3))
    assert list(pickled.load(pickle.dumps({"a": shared, "b": shared}, protocol))) == ["a", "b"]


def test_pickles_of_python_2_are_read():
    content = bytes(range(250, 256)) + bytes(10)
    text = files.Ops(b"U" + bytes([len(content)]) + content)
    data = files.pickled({files.Ops(b"U\1a"): files.array((2,), data=text)})
    assert pickled.load(data)["a"].tobytes() == content
    assert_equal_to_numpy(data)


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        ([np.ones(2)], "opcode EMPTY_LIST"),
        ({"a": {"b": np.ones(2)}}, "'a' is not a numpy array; an npz"),
        ({"a": "text"}, "'a' is not a numpy array"),
        ({"a": np.float32(1)}, "asks for numpy._core.multiarray.scalar"),
        ({"a": np.ones(2, complex)}, "elements of the type c16"),
        ({"a": np.ones(2, [("x", "f8")])}, "elements of the type V8"),
        ({"a": np.ma.ones(2)}, "asks for numpy.ma"),
        ({1: np.ones(2)}, "key of its dictionary is not text"),
        ({"a": len}, "asks for builtins.len"),
    ],
)
def test_other_content_is_refused_with_the_opcode_or_the_name(content, cause):
    with pytest.raises(InputError, match=cause):
        pickled.load(pickle.dumps(content, 4))


def test_buffers_outside_the_file_are_refused():
    with pytest.raises(InputError, match="opcode NEXT_BUFFER"):
        pickled.load(pickle.dumps({"a": np.ones(2)}, 5, buffer_callback=[].append))


def test_the_number_of_opcodes_is_limited(monkeypatch):
    data = pickle.dumps({str(number): np.ones(2) for number in range(10)})
    monkeypatch.setattr(pickled, "MAX_OPCODES", sum(1 for _ in pickletools.genops(data)))
    assert len(pickled.load(data)) == 10
    monkeypatch.setattr(pickled, "MAX_OPCODES", pickled.MAX_OPCODES - 1)
    with pytest.raises(InputError, match="opcodes"):
        pickled.load(data)


@functools.cache
def valid(protocol):
    content = {"a": np.ones((2, 3)), "b": np.zeros((2, 1), bool), "c": np.asfortranarray(np.ones((2, 2), ">i4"))}
    return pickle.dumps(content, protocol)


def assert_accepted_only_with_numpys_result(data):
    message = ""
    try:
        pickled.load(data)
    except InputError as error:
        message = str(error)
    else:
        assert_equal_to_numpy(data)
    assert len(message) < 1000
    assert message.isprintable()


@FUZZ
@given(
    st.sampled_from(PROTOCOLS),
    st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 4), st.binary(max_size=4)), min_size=1, max_size=3
    ),
)
def test_changed_bytes_are_refused_or_read_as_numpy_reads_them(protocol, changes):
    data = valid(protocol)
    for where, length, text in changes:
        offset = int(where * len(data))
        data = data[:offset] + text + data[offset + length :]
    assert_accepted_only_with_numpys_result(data)


OTHER_OPCODES = [code.code.encode("latin1") for code in pickletools.opcodes]
NUMBERS = [b"I%d\n" % number for number in (-1, 0, 1, 2, 3, 6, 1 << 40)] + [b"I00\n", b"I01\n", b"I010\n", b"I1_0\n"]
POOL = [*OTHER_OPCODES, *NUMBERS, *[part for protocol in PROTOCOLS for part in cut(valid(protocol))]]


@FUZZ
@given(
    st.sampled_from(PROTOCOLS),
    st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 3), st.lists(st.sampled_from(POOL), max_size=3)),
        min_size=1,
        max_size=3,
    ),
)
def test_changed_opcodes_are_refused_or_read_as_numpy_reads_them(protocol, changes):
    parts = cut(valid(protocol))
    for where, length, inserted in changes:
        start = int(where * len(parts))
        parts = [*parts[:start], *inserted, *parts[start + length :]]
    assert_accepted_only_with_numpys_result(b"".join(parts))


@FUZZ
@given(st.lists(st.sampled_from(POOL), max_size=40))
@example([b"}", b"."])
def test_random_opcodes_are_refused_or_read_as_numpy_reads_them(parts):
    assert_accepted_only_with_numpys_result(b"".join([*parts, b"."]))
