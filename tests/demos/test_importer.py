"""The importer reads recordings of the original benchmark, refuses other files, and executes nothing in them."""

import ast
import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import earl_jax
from earl_jax import assets
from earl_jax.arrays.plain import MAX_BYTES
from earl_jax.cli.main import main
from earl_jax.demos import importer
from earl_jax.envs import make
from earl_jax.errors import InputError
from tests.demos.attack_files import ATTACKS

FUZZ = settings(max_examples=100, deadline=None)
ROOT = Path(earl_jax.__file__).parent.parent


def arrays(episodes=2, length=5, size=14):
    rng = np.random.default_rng(0)
    rows = episodes * length
    ends = (np.arange(rows) % length == length - 1)[:, None]
    return {
        "observations": rng.normal(size=(rows, size)),
        "actions": rng.uniform(-1, 1, (rows, 4)),
        "rewards": ends.astype(float),
        "next_observations": rng.normal(size=(rows, size)),
        "terminals": ends,
    }


def pickled(path, content, protocol=4):
    path.write_bytes(pickle.dumps(content, protocol))
    return path


class Bomb:
    def __init__(self, flag):
        self.flag = flag

    def __reduce__(self):
        return os.system, (f"touch {self.flag}",)


class Disguised:
    """Asks for allowed names only, to call numpy's array class with a shape of its own."""

    def __reduce__(self):
        return np.ndarray, ((1 << 40,),)


@pytest.mark.parametrize("protocol", [0, 1, 2, 3, 4, 5])
def test_pickles_of_numpy_arrays_are_read(tmp_path, protocol):
    content = arrays()
    recording = importer.read(pickled(tmp_path / "demo.pkl", content, protocol))
    for name, value in recording._asdict().items():
        np.testing.assert_allclose(value, content[name].reshape(value.shape), rtol=1e-6)
    assert [len(episode.actions) for episode in recording.episodes()] == [5, 5]


def test_the_old_name_of_numpys_module_is_allowed(tmp_path):
    raw = pickle.dumps(arrays(), 2).replace(b"numpy._core.multiarray", b"numpy.core.multiarray")
    path = tmp_path / "old.pkl"
    path.write_bytes(raw)
    assert len(importer.read(path).actions) == 10


@pytest.mark.parametrize("where", ["alone", "in an array", "beside the arrays"])
def test_a_hostile_pickle_is_refused_and_not_executed(tmp_path, where):
    flag = tmp_path / "flag"
    bomb = Bomb(flag)
    trap = np.array([bomb], object)
    system = r"asks for (posix|nt).system"
    content, cause = {
        "alone": (bomb, system),
        "in an array": ({**arrays(), "rewards": trap}, "elements of the type O8"),
        "beside the arrays": ({**arrays(), "x": bomb}, system),
    }[where]
    path = pickled(tmp_path / "hostile.pkl", content)
    with pytest.raises(InputError, match=rf"hostile.pkl: .*{cause}"):
        importer.read(path)
    assert not flag.exists()


@pytest.mark.parametrize(
    "content",
    [b"", b"not a pickle", pickle.dumps(Disguised()), pickle.dumps(len), b"cbuiltins\neval\n(S'1'\ntR.", b"P1\n."],
    ids=["empty", "text", "numpy's class called", "a builtin", "eval", "persistent id"],
)
def test_any_other_file_is_an_error_that_names_the_file(tmp_path, content):
    path = tmp_path / "other.pkl"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"other.pkl: not a pickle of numpy arrays"):
        importer.read(path)


LIMITED = """
import json, pathlib, resource, sys
from earl_jax.demos import importer
from tests.demos.attack_files import ATTACKS

pages = int(pathlib.Path("/proc/self/statm").read_text().split()[0])
limit = pages * resource.getpagesize() + (400 << 20)
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
messages = {}
path = pathlib.Path(sys.argv[1])
for name, content in ATTACKS.items():
    path.write_bytes(content())
    try:
        messages[name] = f"read {importer.read(path)}"
    except Exception as error:
        messages[name] = f"{type(error).__name__}: {error}"
print(json.dumps(messages))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="limits the memory of a process as Linux counts it")
def test_every_attack_is_refused_in_one_line_within_little_memory_and_time(tmp_path):
    path = tmp_path / "attack"
    run = subprocess.run([sys.executable, "-c", LIMITED, path], capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0, run.stderr
    messages = json.loads(run.stdout)
    assert list(messages) == list(ATTACKS)
    odd = {name: text for name, text in messages.items() if not text.startswith(f"InputError: {path}: ")}
    assert odd == {}
    assert [name for name, text in messages.items() if "\n" in text or len(text) > 1000 or "memory" in text] == []


def test_the_command_refuses_an_attack_in_one_line_and_writes_nothing(tmp_path, capsys):
    path = tmp_path / "attack.pkl"
    path.write_bytes(ATTACKS["subdtype_larger_than_its_dtype"]())
    with pytest.raises(SystemExit) as stop:
        main(["import-demos", str(path)])
    assert stop.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [path]


def test_files_that_are_too_large_or_not_regular_are_refused_unread(tmp_path):
    large, pipe = tmp_path / "large.pkl", tmp_path / "pipe.pkl"
    large.touch()
    os.truncate(large, MAX_BYTES + 1)
    os.mkfifo(pipe)
    for path, cause in ((large, "larger than 512 MiB"), (pipe, "not a regular file"), (tmp_path, "not a regular file")):
        with pytest.raises(InputError, match=f"{path.name}: {cause}"):
            importer.read(path)


def test_missing_memory_is_invalid_input(tmp_path, monkeypatch):
    def fail(data):
        raise MemoryError

    monkeypatch.setattr(importer.pickled, "load", fail)
    with pytest.raises(InputError, match=r"demo.pkl: .*more memory than there is"):
        importer.read(pickled(tmp_path / "demo.pkl", arrays()))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return pickled(tmp_path_factory.mktemp("recordings") / "whole.pkl", arrays())


@FUZZ
@given(where=st.floats(0, 1, exclude_max=True), text=st.binary(min_size=1, max_size=8), cut=st.booleans())
def test_a_damaged_pickle_is_a_recording_or_an_error_that_names_the_file(whole, where, text, cut):
    data = whole.read_bytes()
    offset = int(where * len(data))
    damaged = whole.with_name("damaged.pkl")
    damaged.write_bytes(data[:offset] if cut else data[:offset] + text + data[offset + len(text) :])
    try:
        recording = importer.read(damaged)
    except ValueError as error:
        message = str(error)
    else:
        assert len({len(field) for field in recording}) == 1
        message = str(damaged)
    assert str(damaged) in message


@FUZZ
@given(data=st.data())
def test_arrays_of_other_shapes_are_an_error_that_names_the_file(tmp_path_factory, data):
    shapes = st.lists(st.integers(0, 4), max_size=3).map(tuple)
    kinds = st.sampled_from([np.float32, np.float64, np.int64, np.bool_, np.complex64, "U3", "datetime64[s]"])
    content = {name: np.zeros(data.draw(shapes), data.draw(kinds)) for name in importer.Recording._fields}
    path = tmp_path_factory.getbasetemp() / "any.npz"
    np.savez(path, **content)
    with pytest.raises(ValueError, match=r"any\.npz: "):  # zeros end no episode
        importer.read(path)


LOADERS = {"load", "loads", "Unpickler", "memmap", "fromfile"}


def test_nothing_else_in_the_package_unpickles():
    """Every reader of files that could execute code is the restricted one, or has `allow_pickle=False`."""
    unsafe = []
    for path in Path(earl_jax.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            loads = called.split(".")[0] in (
                "pickle",
                "cloudpickle",
                "dill",
                "joblib",
                "torch",
                "np",
                "numpy",
                "marshal",
            )
            safe = any(
                key.arg == "allow_pickle" and ast.unparse(key.value) == "False" for key in getattr(node, "keywords", [])
            )
            if loads and called.split(".")[-1] in LOADERS and not safe:
                unsafe.append(f"{path.name}: {called}")
    assert unsafe == []


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda a: a.pop("actions"), "has the arrays"),
        (lambda a: a.update(actions=a["actions"][:-1]), "don't fit together"),
        (lambda a: a.update(rewards=np.array(["x"] * 10)), "elements of the type U1"),
        (lambda a: a["observations"].__setitem__(0, np.nan), "not finite"),
        (lambda a: a["terminals"].__setitem__(-1, False), "middle of an episode"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_with_the_cause(tmp_path, change, cause):
    content = arrays()
    change(content)
    with pytest.raises(ValueError, match=cause):
        importer.read(pickled(tmp_path / "odd.pkl", content))


def test_imported_demonstrations_can_be_used_as_a_demo_file(tmp_path, capsys):
    shipped = {name: assets.demos("sawyer_door", name) for name in assets.DIRECTIONS}
    files = {}
    for name, part in shipped.items():
        observations = np.hstack([part.states, part.goals])
        next_observations = np.hstack([part.next_states, part.goals])
        fields = [observations, part.actions, part.rewards, next_observations, part.ends]
        content = dict(zip(importer.Recording._fields, fields, strict=True))
        files[name] = pickled(tmp_path / f"{name}.pkl", content)
    out = tmp_path / "mine.npz"
    main(["import-demos", str(files["forward"]), "--backward", str(files["backward"]), "--out", str(out)])
    assert "5 forward, 5 backward" in capsys.readouterr().out
    env = make("sawyer_door", demo_file=str(out))
    assert env.demo_directions == assets.DIRECTIONS
    for name, part in shipped.items():
        np.testing.assert_array_equal(env.demos(name).states, part.states)
    with pytest.raises(SystemExit):
        main(["import-demos", str(files["forward"]), "--out", str(out)])
    assert "exists" in capsys.readouterr().err
    main(["import-demos", str(files["forward"])])
    alone = make("sawyer_door", demo_file=str(tmp_path / "forward_imported.npz"))
    with pytest.raises(ValueError, match="no backward demonstrations"):
        alone.demos("backward")
