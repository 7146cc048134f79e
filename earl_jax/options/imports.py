"""Files with tasks, methods and learners of a user, which `--import` and sweep files name.

A process first notes a file with the hash of its text, which does not load jax, and later runs the file if the text has
not changed.
"""

import hashlib
import importlib.util
import re
import shlex
import sys
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError, brief
from earl_jax.options import registry

Record = dict[str, str]
"""What a run records about a file: `file`, its path as given, and `sha256`, the hash of its text."""
_noted: dict[Path, Record] = {}


def records() -> list[Record]:
    """Return the records of the files that this process has noted."""
    return list(_noted.values())


def resume_command(folder: Path) -> str:
    """Return the command that continues the run in `folder`, with the files that this process has noted."""
    files = [part for record in records() for part in ("--import", record["file"])]
    return shlex.join(["earl-jax", "resume", str(folder), *files])


def latest(values: list[Record]) -> dict[str, Record]:
    """Return the last record of each file, by file name without the folder."""
    return {Path(record["file"]).name: record for record in values}


def short_hash(record: Record) -> str:
    """Return the start of the hash of a file, for a message."""
    return record["sha256"][:8]


def check_records(values: Any) -> None:
    """Raise an InputError unless `values`, which come from a config.json, are a list of records."""
    is_list = isinstance(values, list) and all(isinstance(record, dict) for record in values)
    texts = [record.get(key) for record in values for key in ("file", "sha256")] if is_list else [None]
    if not all(isinstance(text, str) and text.isprintable() for text in texts):
        raise InputError(f"imports must be a list of files, each with its sha256, not {brief(values)}")


def note(file: str | Path, sha256: str | None = None) -> None:
    """Note `file` for `run_noted`, with the `sha256` that its text must have then; by default its present hash.

    Raises:
        ValueError: there is no such file, or its name does not end in .py.
    """
    path = Path(file)
    if path.suffix != ".py":
        raise InputError(f"{file} can't be imported: its name does not end in .py")
    if not path.is_file():
        raise InputError(f"{file} can't be imported: there is no such file")
    sha256 = sha256 or hashlib.sha256(path.read_bytes()).hexdigest()
    _noted.setdefault(path.resolve(), {"file": str(file), "sha256": sha256})


def run_noted() -> None:
    """Run every noted file that has not run in this process, as a module.

    While a file runs, its folder is first on the path, so that it finds modules beside it. Later the folder is last, so
    that these modules hide no others.

    Raises:
        ValueError: a file has changed, registers nothing, or has the name of another module. Other errors in a file keep
            their traceback.
    """
    for path, record in list(_noted.items()):
        content = path.read_bytes()
        now = hashlib.sha256(content).hexdigest()
        if now != record["sha256"]:
            hashes = f"sha256 {short_hash(record)} then, {now[:8]} now"
            raise InputError(
                f"{record['file']} has changed since this command first read it ({hashes}); repeat "
                "the command, so that all of it is of one text"
            )
        _run_once(path, content)


def _run_once(path: Path, content: bytes) -> None:
    name, folder = re.sub(r"\W", "_", path.stem), str(path.parent)
    if getattr(sys.modules.get(name), "__file__", None) == str(path):
        return
    sys.path.insert(0, folder)
    try:
        found = importlib.util.find_spec(name)
        if found and Path(found.origin or "").resolve() != path:
            raise InputError(f"{path} has the name of another module, {found.origin}; rename the file")
        _run(name, path, content)
    finally:
        sys.path.remove(folder)
        sys.path.append(folder)


def _run(name: str, path: Path, content: bytes) -> None:
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    registered = len(registry.REGISTERED)
    try:
        exec(compile(content, str(path), "exec", dont_inherit=True), module.__dict__)
        if len(registry.REGISTERED) == registered:
            raise InputError("it registers nothing; call earl_jax.register_algo, register_env or register_learner")
    except BaseException as error:
        del sys.modules[name]
        if isinstance(error, InputError):
            raise InputError(f"{path} can't be imported: {error}") from error
        error.add_note(f"earl-jax: {path} can't be imported")
        raise
