"""Zips that attack a reader of recordings, assembled from their records."""

import functools
import struct
import zlib
from collections.abc import Callable

from tests.demos.attack_pickles import FIELDS, GIB, SYSTEM, call, pickled


def npy(shape: str = "(2, 4)", descr: str = "'<f8'", data: bytes = bytes(64), header: str | None = None) -> bytes:
    text = header or f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"
    return b"\x93NUMPY\2\0" + struct.pack("<I", len(text) + 1) + text.encode("latin1") + b"\n" + data


def entry(name: str, data: bytes, **changes) -> dict:
    """A member of a zip, deflated, whose header says what `changes` give."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(data) + packer.flush()
    return {"name": name.encode(), "packed": packed, "size": len(data), "crc": zlib.crc32(data), **changes}


def zipped(entries: list[dict], **ends) -> bytes:
    """A zip of the entries; `ends` replace parts of the record at its end."""
    body, directory = b"", b""
    for part in entries:
        extra = part.get("extra", b"")
        sizes = (part["crc"], part.get("packed_size", len(part["packed"])), part["size"])
        common = struct.pack("<HHHHHIII", 45, part.get("flags", 0), part.get("method", 8), 0, 33, *sizes)
        offset = part.get("offset", len(body))
        local = b"PK\3\4" + common + struct.pack("<HH", len(part["name"]), 0) + part["name"]
        lengths = struct.pack("<HHHHHII", len(part["name"]), len(extra), 0, 0, 0, 0, offset)
        directory += b"PK\1\2" + struct.pack("<H", 45) + common + lengths + part["name"] + extra
        body += local + part["packed"]
    size, start = ends.get("size", len(directory)), ends.get("start", len(body))
    end = b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, len(entries), len(entries), size, start, 0)
    return body + directory + ends.get("between", b"") + end + ends.get("after", b"")


def npz(first: dict | None = None, flags: bytes = b"\0\1", **ends) -> bytes:
    """A recording of two rows with another first member."""
    parts = (npy(), npy(), npy("(2,)", data=bytes(16)), npy(), npy("(2,)", "'|b1'", flags))
    contents = zip(FIELDS, parts, strict=True)
    members = [entry(f"{field}.npy", content) for field, content in contents]
    return zipped([first or members[0], *members[1:]], **ends)


@functools.cache
def zeros(mebibytes: int) -> dict:
    """A member of that many MiB of zeros, packed in a thousandth of them."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    header = npy(f"({mebibytes << 17},)", data=b"")
    start = packer.compress(header) + packer.flush(zlib.Z_FULL_FLUSH)
    piece = packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH)
    packed = start + piece * mebibytes + packer.flush()
    size = min(len(header) + (mebibytes << 20), 0xFFFFFFFE)
    return {"name": b"observations.npy", "packed": packed, "size": size, "crc": 0}


def observations(data: bytes | None = None, **changes) -> Callable[[], bytes]:
    return lambda: npz(entry("observations.npy", npy() if data is None else data, **changes))


def zip64(size: int, packed: int, offset: int) -> bytes:
    return struct.pack("<HHQQQ", 1, 24, size, packed, offset)


def many_members() -> bytes:
    """A zip whose directory lists 300,000 members."""
    one = zipped([entry("x", b"")])
    start = one.index(b"PK\1\2")
    directory = one[start:-22] * 300_000
    return one[:start] + directory + b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 9, 9, len(directory), start, 0)


HUGE = 0xFFFFFFFF
NPZ: dict[str, Callable[[], bytes]] = {
    "npz_header_of_8_tib": observations(npy("(1099511627776,)")),
    "npz_header_and_size_of_8_tib": observations(
        npy("(1099511627776,)"), size=HUGE, packed_size=HUGE, offset=HUGE, extra=zip64(8 << 40, 100, 0)
    ),
    "npz_of_10_gib_in_10_mb": lambda: npz(zeros(10_240)),
    "npz_of_500_mib_in_half_a_mb": lambda: npz(zeros(500)),
    "npz_of_60_mib_in_60_kb": lambda: npz(zeros(60)),
    "npz_member_smaller_than_it_says": observations(npy("(1000000,)"), size=len(npy("(1000000,)")) - 64 + 8_000_000),
    "npz_member_larger_than_it_says": observations(npy(data=bytes(1 << 20)), size=len(npy())),
    "npz_packed_size_too_small": observations(packed_size=10),
    "npz_wrong_checksum": observations(crc=1),
    "npz_damaged_stream": observations(packed=b"\xff" * 100),
    "npz_truncated_stream": observations(packed=b"\0"),
    "npz_offset_beyond_the_file": observations(offset=1 << 31),
    "npz_offset_of_an_exabyte": observations(size=HUGE, packed_size=HUGE, offset=HUGE, extra=zip64(150, 90, 1 << 63)),
    "npz_bad_extra_field": observations(extra=b"\1\0\xff\xff"),
    "npz_encrypted": observations(flags=1),
    "npz_patched": observations(flags=1 << 5),
    "npz_in_lzma": observations(method=14, packed=b"\x09\x04\x05\0\x5d\xff\xff\xff\xff" + bytes(50)),
    "npz_in_bzip2": observations(method=12),
    "npz_in_an_unknown_method": observations(method=99),
    "npz_same_name_twice": lambda: zipped([entry("observations.npy", npy())] * 2),
    "npz_name_with_a_null_byte": lambda: zipped([entry(f"observations.npy{end}", npy()) for end in ("", "\0x")]),
    "npz_without_the_arrays": lambda: zipped([entry("x.npy", npy())]),
    "npz_of_300_000_members": many_members,
    "npz_directory_of_4_gib": lambda: npz(size=0xFFFFFFFF, start=0),
    "npz_directory_in_zip64": lambda: npz(
        between=b"PK\6\6" + struct.pack("<QHHIIQQQQ", 44, 45, 45, 0, 0, 5, 5, 1 << 50, 0)
        + b"PK\6\7" + struct.pack("<IQI", 0, 0, 1)
    ),
    "npz_with_a_comment": lambda: npz(after=b"\0" * 40),
    "npz_cut_off": lambda: npz()[:-30],
    "npz_start_only": lambda: b"PK\3\4",
    "npz_object_array": observations(npy("(1,)", "'|O'", pickled(call(SYSTEM, "exit 1")))),
    "npz_structured_array": observations(npy("(2,)", "[('a', '<f8')]")),
    "npz_subarray_of_a_tebibyte": observations(npy("(1,)", "('<f8', (1073741824, 1024))")),
    "npz_header_of_brackets": observations(npy(header="{'descr': " + "[" * 3000)),
    "npz_header_of_signs": observations(npy(header="{'descr': " + "-" * 4000 + "1}")),
    "npz_header_of_a_gibibyte": observations(b"\x93NUMPY\2\0" + struct.pack("<I", GIB) + b"{"),
    "npz_header_that_is_code": observations(npy(header="__import__('os').system('exit 1')")),
    "npz_shape_of_a_huge_number": observations(npy(f"({'9' * 3000},)")),
    "npz_negative_shape": observations(npy("(-2, -4)")),
    "npz_shape_that_overflows": observations(npy("(4294967296, 4294967296)")),
    "npz_shape_of_100_axes": observations(npy("(" + "1, " * 99 + "8)")),
    "npz_bools_of_value_255": lambda: npz(flags=b"\xff\xff"),
    "npz_unknown_version": observations(b"\x93NUMPY\x09\0" + bytes(100)),
    "npz_member_without_content": observations(b""),
}  # fmt: skip
