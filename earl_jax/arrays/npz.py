"""A reader of npz files of plain arrays that checks every size in the file before it unpacks anything."""

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Sequence
from typing import IO

import numpy as np

from earl_jax.arrays.plain import MAX_BYTES, array_bytes, build_array, element_type, shortened
from earl_jax.errors import InputError

SIGNATURE = b"PK\x03\x04"
MAX_DIRECTORY_BYTES = 1 << 20
"""Limit for the zip's list of members, about 15,000 of them."""
FREE_BYTES = 64 << 20
MAX_RATIO = 100
"""Arrays larger than `FREE_BYTES` may have so many times the size of the file."""
MAX_HEADER_BYTES = 4096
PIECE_BYTES = 1 << 20
DAMAGE = (ValueError, zipfile.BadZipFile, NotImplementedError, OverflowError, EOFError, zlib.error, struct.error)
"""What zipfile raises for a damaged file."""
COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
END_RECORD = struct.Struct("<4s4H2LH")
HEADER = re.compile(
    r"\{'descr': '(?P<order>[<>|])(?P<code>\w{1,8})', 'fortran_order': (?P<fortran>True|False), "
    r"'shape': \((?P<shape>|\d{1,20}L?,|\d{1,20}L?(?:, ?\d{1,20}L?){1,20},?)\),? ?\}\s*"
)


def load(data: bytes, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the arrays of an npz file that have one of `names`; no other member is read.

    Raises:
        ValueError: the file is damaged, one of these arrays holds more than numbers and bools, or they are too large.
    """
    try:
        _check_directory_size(data)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return {name: _read_array(archive, member) for name, member in _members(archive, names, len(data)).items()}
    except DAMAGE as error:
        raise InputError(f"not an npz file of plain arrays: {shortened(error)}") from error


def _check_directory_size(data: bytes) -> None:
    """Read the size of the list of members where zipfile reads it, because zipfile reads all of the list."""
    record = data[-END_RECORD.size :]
    locator = data[-END_RECORD.size - 20 : -END_RECORD.size]
    if len(record) < END_RECORD.size or not record.startswith(b"PK\x05\x06") or not record.endswith(b"\0\0"):
        raise InputError("it does not end with the record that ends an npz file")
    if locator.startswith(b"PK\x06\x07") or END_RECORD.unpack(record)[5] > MAX_DIRECTORY_BYTES:
        raise InputError(f"its list of members is larger than {MAX_DIRECTORY_BYTES >> 10} KiB")


def _members(archive: zipfile.ZipFile, names: Sequence[str], file_size: int) -> dict[str, zipfile.ZipInfo]:
    """Return the members with the arrays `names`, after a check of their sizes."""
    stored = [info for info in archive.infolist() if info.filename.removesuffix(".npy") in names]
    members = {info.filename.removesuffix(".npy"): info for info in stored}
    if len(members) < len(stored):
        raise InputError("two of its members have the same name")
    if any(info.flag_bits & 1 or info.compress_type not in COMPRESSIONS for info in stored):
        raise InputError("a member is encrypted or packed in another way than numpy packs")
    total = sum(info.file_size for info in stored)
    if total > MAX_BYTES + MAX_HEADER_BYTES * len(names):
        raise InputError(f"its arrays are larger than {MAX_BYTES >> 20} MiB, the limit")
    if total > max(FREE_BYTES, MAX_RATIO * file_size):
        raise InputError(f"its arrays are more than {MAX_RATIO} times as large as the file")
    return members


def _read_array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(info) as member:
        dtype, shape, order, header_size = _read_header(member)
        size = array_bytes(dtype, shape)
        if header_size + size != info.file_size:
            raise InputError(f"{info.filename} has {info.file_size} bytes, and its header needs {header_size + size}")
        data = bytearray()
        while piece := member.read(min(PIECE_BYTES, size - len(data))):
            data += piece
    return build_array(data, dtype, shape, order)


def _read_header(member: IO[bytes]) -> tuple[np.dtype, tuple[int, ...], str, int]:
    """Return the dtype, the shape and the order of an npy member, and the size of its header."""
    start = member.read(8)
    if start not in (b"\x93NUMPY\1\0", b"\x93NUMPY\2\0", b"\x93NUMPY\3\0"):
        raise InputError("a member is not an npy file of version 1 to 3")
    length = member.read(2 if start[6] == 1 else 4)
    size = int.from_bytes(length, "little")
    if size > MAX_HEADER_BYTES:
        raise InputError(f"a member has a header of {size} bytes; the limit is {MAX_HEADER_BYTES}")
    text = member.read(size).decode("latin1")
    header = HEADER.fullmatch(text)
    if header is None:
        raise InputError(f"a member's header is not that of a plain array: {text.strip()}")
    shape = tuple(int(axis.strip(" L")) for axis in header["shape"].split(",") if axis.strip())
    order = "F" if header["fortran"] == "True" else "C"
    return element_type(header["code"], header["order"]), shape, order, len(start) + len(length) + len(text)
