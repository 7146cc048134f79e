"""The reader of npz files returns what numpy would, and refuses files whose sizes disagree before unpacking them."""

import io
import struct
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from earl_jax.arrays import npz, plain
from earl_jax.errors import InputError
from tests.demos import attack_zips as files

FUZZ = settings(max_examples=150, deadline=None)
TYPES = ["?", "i1", "u1", "<i2", ">u4", "<i8", "<f2", ">f4", "<f8"]


def saved(content, save=np.savez_compressed):
    handle = io.BytesIO()
    save(handle, **content)
    return handle.getvalue()


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_of_every_type_and_order_are_read(save):
    values = np.arange(12).reshape(3, 4)
    parts = {"c": values, "f": np.asfortranarray(values), "row": values[0], "number": np.array(3), "empty": values[:0]}
    content = {f"{name} {code}": part.astype(code) for name, part in parts.items() for code in TYPES}
    read = npz.load(saved(content, save), list(content))
    assert list(read) == list(content)
    for name, array in read.items():
        assert (array.dtype, array.tolist()) == (content[name].dtype, content[name].tolist())


def test_only_the_arrays_asked_for_are_read():
    data = saved({"a": np.ones(2), "b": np.array([object()], object)}, np.savez)
    assert list(npz.load(data, ["a", "c"])) == ["a"]


@pytest.mark.parametrize("shape", ["(2L, 4L)", "(2,4)", "(2, 4,)"])
def test_headers_of_other_writers_are_read(shape):
    assert (
        npz.load(files.npz(files.entry("observations.npy", files.npy(shape))), files.FIELDS)["observations"].size == 8
    )


def test_arrays_that_pack_well_have_a_limit_above_64_mib():
    arrays = {"a": np.zeros((9 << 20,))}
    with pytest.raises(InputError, match="more than 100 times as large"):
        npz.load(saved(arrays), ["a"])


@pytest.mark.parametrize(
    "attack", ["npz_header_of_8_tib", "npz_of_10_gib_in_10_mb", "npz_of_500_mib_in_half_a_mb", "npz_object_array"]
)
def test_sizes_and_types_are_checked_before_the_content_is_unpacked(attack, monkeypatch):
    unpacked = []
    read = zipfile.ZipExtFile.read
    monkeypatch.setattr(zipfile.ZipExtFile, "read", lambda *args: unpacked.append(read(*args)) or unpacked[-1])
    with pytest.raises(InputError):
        npz.load(files.NPZ[attack](), files.FIELDS)
    assert len(b"".join(unpacked)) < 200


def test_the_sum_of_the_arrays_is_limited(monkeypatch):
    data = saved({"a": np.ones(600), "b": np.ones(600)}, np.savez)
    assert len(npz.load(data, ["a", "b"])) == 2
    monkeypatch.setattr(npz, "MAX_BYTES", 1 << 10)
    monkeypatch.setattr(npz, "MAX_HEADER_BYTES", 128)
    with pytest.raises(InputError, match="larger than"):
        npz.load(data, ["a", "b"])


VALID = files.npz()
FORMATS = ["<H", "<I", "<Q"]


@FUZZ
@given(
    st.lists(
        st.tuples(
            st.floats(0, 1, exclude_max=True), st.sampled_from(FORMATS), st.integers(0, (1 << 64) - 1), st.booleans()
        ),
        min_size=1,
        max_size=3,
    )
)
def test_a_damaged_npz_is_refused_or_read_as_numpy_reads_it(changes):
    data = VALID
    for where, form, number, insert in changes:
        offset, text = 4 + int(where * (len(data) - 4)), struct.pack("<Q", number)[: struct.calcsize(form)]
        data = data[:offset] + text + data[offset + (0 if insert else len(text)) :]
    read, message = {}, ""
    try:
        read = npz.load(data, files.FIELDS)
    except InputError as error:
        message = str(error)
    assert message.isprintable()
    if not message:
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            assert all(np.array_equal(array, stored[name], equal_nan=True) for name, array in read.items())


@pytest.mark.parametrize(
    ("code", "order"), [("f1", "|"), ("b2", "<"), ("V8", "|"), ("f8", "|"), ("f8", "="), ("u1", "<"), ("f8, f8", "<")]
)
def test_other_element_types_and_byte_orders_are_refused(code, order):
    with pytest.raises(InputError, match=r"elements of the type"):
        plain.element_type(code, order)
