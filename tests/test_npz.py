"""The reader of npz files returns what numpy would, and refuses files whose sizes, types or values lie."""

import io
import struct
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from earl_jax import npz
from earl_jax.errors import InputError
from earl_jax.npz import load_npz

TYPES = ["?", "i1", "u1", "<i2", ">u4", "<i8", "<f2", ">f4", "<f8"]


def saved(content, save=np.savez):
    handle = io.BytesIO()
    save(handle, **content)
    return handle.getvalue()


def npy(descr="'<f8'", shape="(2, 4)", data=bytes(64), header=None):
    text = header or f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"
    return b"\x93NUMPY\2\0" + struct.pack("<I", len(text) + 1) + text.encode() + b"\n" + data


def zipped(*contents, method=zipfile.ZIP_DEFLATED, **directory):
    """A zip of members a.npy, whose entry in the directory says what `directory` gives."""
    handle = io.BytesIO()
    with zipfile.ZipFile(handle, "w", method) as archive:
        for number, content in enumerate(contents or [npy()]):
            archive.writestr(f"{number}.npy" if number else "a.npy", content)
    data = bytearray(handle.getvalue())
    for field, value in directory.items():
        offset = data.index(b"PK\1\2") + {"flags": 8, "crc": 16, "size": 24}[field]
        data[offset : offset + 4] = struct.pack("<I", value)
    return bytes(data)


HOSTILE = {
    "a header of 8 TiB": lambda: zipped(npy(shape="(1099511627776,)")),
    "a directory of 600 MiB": lambda: zipped(size=600 << 20),
    "more than it declares": lambda: zipped(npy(data=bytes(1 << 20)), size=len(npy())),
    "less than its header": lambda: zipped(npy(shape="(1000000,)")),
    "a wrong checksum": lambda: zipped(crc=1),
    "72 MiB in 72 KiB": lambda: saved({"a": np.zeros(9 << 20)}, np.savez_compressed),
    "bzip2": lambda: zipped(method=zipfile.ZIP_BZIP2),
    "lzma": lambda: zipped(method=zipfile.ZIP_LZMA),
    "encryption": lambda: zipped(flags=1),
    "20,000 members": lambda: b"".join([b"PK\3\4", b"PK\1\2" * 20_000, zipped()]),
    "objects": lambda: saved({"a": np.array([print], object)}),
    "fields": lambda: saved({"a": np.ones(2, [("x", "f8")])}),
    "text": lambda: saved({"a": np.array(["x"])}),
    "complex numbers": lambda: saved({"a": np.ones(2, complex)}),
    "bools of value 255": lambda: zipped(npy("'|b1'", "(2,)", b"\xff\xff")),
    "4,000 signs in a header": lambda: zipped(npy(header="{'descr': " + "-" * 4000 + "1}")),
    "a header of a gibibyte": lambda: zipped(b"\x93NUMPY\2\0" + struct.pack("<I", 1 << 30) + b"{"),
    "no array": lambda: zipped(b"text"),
    "an array without a zip": npy,
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_of_every_type_and_order_are_read(save):
    values = np.arange(12).reshape(3, 4)
    parts = {"c": values, "f": np.asfortranarray(values), "row": values[0], "number": np.array(3), "empty": values[:0]}
    content = {f"{name} {code}": part.astype(code) for name, part in parts.items() for code in TYPES}
    read = load_npz(saved(content, save), list(content))
    assert list(read) == list(content)
    for name, array in read.items():
        assert (array.dtype, array.tolist()) == (content[name].dtype, content[name].tolist())


def test_only_the_arrays_asked_for_are_read():
    data = saved({"a": np.ones(2), "b": np.array([object()], object)})
    assert list(load_npz(data, ["a", "c"])) == ["a"]


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_npz_is_refused_in_one_line(name):
    with pytest.raises(InputError, match="not an npz file of plain arrays: ") as stop:
        load_npz(HOSTILE[name](), ["a"])
    assert str(stop.value).isprintable()


def test_the_sum_of_the_arrays_is_limited(monkeypatch):
    data = saved({"a": np.ones(600), "b": np.ones(600)})
    assert len(load_npz(data, ["a", "b"])) == 2
    monkeypatch.setattr(npz, "MAX_BYTES", 9000)
    assert len(load_npz(data, ["a"])) == 1
    with pytest.raises(InputError, match="larger than"):
        load_npz(data, ["a", "b"])


@settings(max_examples=150, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True), form=st.sampled_from("HIQ"), number=st.integers(0, 2**64 - 1))
def test_a_damaged_npz_is_refused_or_read_as_it_was(where, form, number):
    whole = zipped()
    offset, text = int(where * len(whole)), struct.pack("<Q", number)[: struct.calcsize(f"<{form}")]
    read, message = {}, ""
    try:
        read = load_npz(whole[:offset] + text + whole[offset + len(text) :], ["a"])
    except InputError as error:
        message = str(error)
    assert message.isprintable()
    assert not any(array.any() for array in read.values())
