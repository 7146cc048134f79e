"""The importer reads recordings of the original benchmark, refuses other files, and executes nothing in them."""

import _codecs
import ast
import io
import os
import pickle
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import earl_jax
from earl_jax import assets
from earl_jax.envs import make
from earl_jax.envs.demos import importer, unpickle
from earl_jax.errors import InputError
from earl_jax.npz import MAX_BYTES
from tests.cli.process import one_line, run, succeed, unchanged
from tests.conftest import assert_equal_trees

TYPES = ["?", "i1", "u1", "<i2", ">u4", "<i8", "<f2", ">f4", "<f8"]


def arrays():
    rng, ends = np.random.default_rng(0), (np.arange(10) % 5 == 4)[:, None]
    observations = rng.normal(size=(11, 14))
    return {
        "observations": observations[:-1],
        "actions": rng.uniform(-1, 1, (10, 4)),
        "rewards": ends.astype(float),
        "next_observations": observations[1:],
        "terminals": ends,
    }


class Call:
    """What unpickles to the result of a call, to which a state is set afterwards."""

    def __init__(self, function, *arguments, state=None):
        self.reduced = (function, arguments, state)

    def __reduce__(self):
        return self.reduced


def dtype(code="f8", order="<", subdtype=None, names=None, fields=None, size=-1, flags=0):
    return Call(np.dtype, code, False, True, state=(3, order, subdtype, names, fields, size, min(size, 1), flags))


def array(shape=(2, 4), element=None, data=bytes(64)):
    empty = np._core.multiarray._reconstruct
    return Call(empty, np.ndarray, (0,), b"b", state=(1, shape, element or dtype(), False, data))


BYTES = (dtype("u1", "|"), (4096,))
SHARED = bytes(1 << 20)
TEXT = "x" * (1 << 20)
WITH_OBSERVATIONS = {
    "an element with a larger subdtype": lambda: array((2,), dtype("V8", "|", BYTES, size=8), bytes(16)),
    "a field beyond its element": lambda: array((2,), dtype("V8", "|", None, ("a",), {"a": (dtype(), 1 << 30)}, 8)),
    "objects at an address": lambda: array((2, 4), dtype("O8", "|"), b"\x08" * 64),
    "numbers with the flags of objects": lambda: array((2, 4), dtype(flags=63), b"\x08" * 64),
    "an element of a gibibyte": lambda: array((2, 4), dtype(size=1 << 30)),
    "an element of several codes": lambda: array((2,), dtype("(1000000,1000000)f8,O")),
    "a shape larger than its bytes": lambda: array((1 << 20, 1 << 20)),
    "a shape of a thousand axes": lambda: array((1,) * 1000, data=bytes(8)),
    "a shape that overflows": lambda: array((1 << 29, 1 << 29, 1 << 6), data=b""),
    "a negative shape": lambda: array((-2, -4)),
    "an array class with a shape": lambda: Call(np.ndarray, (1 << 40,)),
}
HOSTILE = {
    **{name: lambda make=make: pickle.dumps({**arrays(), "observations": make()}) for name, make in WITH_OBSERVATIONS.items()},
    "a command": lambda: pickle.dumps(Call(os.system, "touch flag_of_an_attack")),
    "a function of numpy": lambda: pickle.dumps(Call(np.load, "x.npy", None, True)),
    "a dotted name": lambda: b"\x80\x04\x8c\x05numpy\x8c\x11ndarray.__class__\x93.",
    "a name with control characters": lambda: b"\x80\x04\x8c\x06a\nb\x1b[2\x8c\x02c\r\x93.",
    "another codec": lambda: pickle.dumps(Call(_codecs.encode, "x" * 99, "zlib_codec")),
    "an address to read from": lambda: b"cnumpy\nndarray\n)\x81}S'__array_interface__'\nNsb.",
    "a crash": lambda: b"}(" + b")" + b"\x85" * 1_000_000 + b"Nu.",
    "600 texts from one": lambda: pickle.dumps([Call(_codecs.encode, TEXT, "latin1") for _ in range(600)]),
    "shared bytes": lambda: pickle.dumps({name: array((1 << 17,), data=SHARED) for name in arrays()}),
    "a memo of four billion": lambda: b"Nr\xff\xff\xff\xff.",
    "bytes of an exabyte": lambda: b"\x80\x04\x8e" + b"\0" * 7 + b"\x10.",
    "a number of a million digits": lambda: b"L" + b"9" * 1_000_000 + b"L\n.",
    "a list": lambda: pickle.dumps([np.ones(2)]),
    "another value": lambda: pickle.dumps({**arrays(), "rewards": "text"}),
    "nothing": lambda: b"",
    "text": lambda: b"not a pickle",
    "half a file": lambda: pickle.dumps(arrays())[:700],
}  # fmt: skip


def pickled(path, content):
    path.write_bytes(pickle.dumps(content))
    return path


@pytest.mark.parametrize("protocol", range(6))
def test_arrays_of_every_type_and_order_are_read(protocol):
    values = np.arange(24).reshape(2, 3, 4)
    parts = {
        "matrix": values[0], "fortran": np.asfortranarray(values[0]), "strided": values[0, :, ::2],
        "number": np.array(7), "empty": np.zeros((0, 3)), "swapped": values.transpose(1, 0, 2),
    }  # fmt: skip
    content = {f"{name} {code}": part.astype(code) for name, part in parts.items() for code in TYPES}
    content["again"] = content["matrix <f8"]
    data = pickle.dumps(content, protocol)
    data = data if protocol > 3 else data.replace(b"numpy._core.", b"numpy.core.")  # the name in numpy 1
    read = unpickle.read(data, list(content))
    assert list(read) == list(content)
    for name, part in read.items():
        assert part.dtype.newbyteorder("=") == content[name].dtype.newbyteorder("=")
        np.testing.assert_array_equal(part, content[name])


def test_pickles_of_python_2_are_read():
    text = bytes(range(248, 256)) * 2
    data = pickle.dumps({"a": array((2,), data=text)}, 3).replace(b"C\x10" + text, b"U\x10" + text)
    assert unpickle.read(data, ["a"])["a"].tobytes() == text


def test_a_system_without_limits_reads_recordings(monkeypatch):
    out = io.BytesIO()
    monkeypatch.setitem(sys.modules, "resource", None)
    monkeypatch.setattr(sys, "argv", ["unpickle.py", "actions"])
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(pickle.dumps(arrays()))))
    monkeypatch.setattr(sys, "stdout", SimpleNamespace(buffer=out))
    unpickle.main()
    assert np.load(io.BytesIO(out.getvalue()))["actions"].shape == (10, 4)


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_costs_one_line_and_runs_nothing(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "hostile.pkl"
    path.write_bytes(HOSTILE[name]())
    with pytest.raises(InputError, match=r"hostile.pkl: not a(n npz file of plain| pickle of numpy) arrays: ") as stop:
        importer.read(path)
    assert str(stop.value).isprintable()
    assert len(str(stop.value)) < 500
    assert list(tmp_path.iterdir()) == [path]


def test_a_pickle_that_takes_too_long_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(importer, "LONGEST", 0.001)
    with pytest.raises(InputError, match=r"demo.pkl: .*takes more than 0.001 s"):
        importer.read(pickled(tmp_path / "demo.pkl", arrays()))


def test_files_that_are_too_large_or_not_regular_are_refused_unread(tmp_path):
    large, pipe = tmp_path / "large.pkl", tmp_path / "pipe.pkl"
    large.touch()
    os.truncate(large, MAX_BYTES + 1)
    os.mkfifo(pipe)
    for path, cause in ((large, "larger than 512 MiB"), (pipe, "not a regular file"), (tmp_path, "not a regular file")):
        with pytest.raises(InputError, match=f"{path.name}: {cause}"):
            importer.read(path)


def test_nothing_else_in_the_package_unpickles_but_workers_from_their_own_pipe():
    loaders = {"load", "loads", "Unpickler", "memmap", "fromfile"}
    modules = {"pickle", "cloudpickle", "dill", "joblib", "torch", "np", "numpy", "marshal"}
    unsafe = []
    for path in Path(earl_jax.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            called = ast.unparse(node.func).split(".") if isinstance(node, ast.Call) else [""]
            words = [ast.unparse(word) for word in getattr(node, "keywords", [])]
            if called[0] in modules and called[-1] in loaders and "allow_pickle=False" not in words:
                unsafe.append(f"{path.name}: {called}")
    assert unsafe == ["workers.py: ['pickle', 'load']"]


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda a: a.pop("actions"), "must contain the arrays"),
        (lambda a: a.update(actions=a["actions"][:-1]), "don't fit together"),
        (lambda a: a.update(rewards=np.array(["x"] * 10)), "elements of the type .U1"),
        (lambda a: a.update(observations=a["observations"][:, 1:]), r"\(10, 13\), not rows of a state and a goal"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_with_the_cause(tmp_path, change, cause):
    content = arrays()
    change(content)
    np.savez(tmp_path / "odd.npz", **content)
    with pytest.raises(InputError, match=rf"odd.npz: .*{cause}"):
        importer.read(tmp_path / "odd.npz")


def test_imported_demonstrations_can_be_used_as_a_demo_file(tmp_path):
    shipped = {name: assets.demos("sawyer_door", name) for name in assets.DIRECTIONS}
    files = {}
    for name, part in shipped.items():
        observations = np.hstack([part.states, part.goals])
        next_observations = np.hstack([part.next_states, part.goals])
        fields = [observations, part.actions, part.rewards, next_observations, part.ends]
        content = {field: np.float64(array) for field, array in zip(importer.FIELDS, fields, strict=True)}
        files[name] = pickled(tmp_path / f"{name}.pkl", {**content, "comment": "text"})
    out = tmp_path / "mine.npz"
    told = succeed("import-demos", files["forward"], "--backward", files["backward"], "--out", out)
    assert "5 forward, 5 backward" in told
    env = make("sawyer_door", demo_file=str(out))
    assert env.demonstrations.directions == assets.DIRECTIONS
    for name, part in shipped.items():
        assert_equal_trees(env.demonstrations.load(name), part)
    with unchanged(out.parent, but="mine"):
        one_line(run("import-demos", files["forward"], "--out", out), "exists")
        succeed("import-demos", files["forward"], "--out", out.with_suffix(""))
    named = make("sawyer_door", demo_file=str(out.with_suffix("")))
    assert named.demonstrations.directions == ("forward",), "a file has the name that was given, whatever its suffix"
    succeed("import-demos", files["forward"])
    alone = make("sawyer_door", demo_file=str(tmp_path / "forward_imported.npz"))
    with pytest.raises(ValueError, match="no backward demonstrations"):
        alone.demonstrations.load("backward")
