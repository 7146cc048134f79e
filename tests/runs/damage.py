"""Damage to run folders: each function damages a copy of a good one, of a finished or of a running run.

The functions of `LINKS` make links to `victim_of(folder)`, which no command may change.
"""

import json
import os
import shutil

from earl_jax.runs.manifest import manifest_text

SECRET = "mine\n"


def victim_of(folder):
    """Return the path, beside `folder`, of the file or folder to which links lead."""
    return folder.parent / f"victim-{folder.name}"


def _table(change):
    """Return a function that replaces the lines of metrics.csv by `change(lines)`."""

    def damage(folder):
        path = folder / "metrics.csv"
        path.write_text("".join(change(path.read_text().splitlines(keepends=True))))

    return damage


def _bytes(change):
    def damage(folder):
        path = folder / "metrics.csv"
        path.write_bytes(change(path.read_bytes()))

    return damage


def _with_other_seeds(lines):
    cells = [line.split(",") for line in lines]
    seed = cells[0].index("seed")
    return [lines[0]] + [",".join([*row[:seed], str(int(row[seed]) + 1000), *row[seed + 1 :]]) for row in cells[1:]]


TABLE = {
    "table missing": lambda folder: (folder / "metrics.csv").unlink(),
    "table empty": _bytes(lambda data: b""),
    "table with its header only": _table(lambda lines: lines[:1]),
    "table of binary data": _bytes(lambda data: bytes(range(256)) * 40),
    "table with a row twice": _table(lambda lines: [*lines[:3], lines[2], *lines[3:]]),
    "table without its second row": _table(lambda lines: lines[:2] + lines[3:]),
    "table without its last evaluations": _table(lambda lines: lines[:3]),
    "table of other seeds": _table(_with_other_seeds),
    "table with its rows in reverse": _table(lambda lines: [lines[0], *lines[:0:-1]]),
    "table without a header": _table(lambda lines: lines[1:]),
    "table with another header": _table(lambda lines: ["a,b,c\n", *lines[1:]]),
    "table with a column twice": _table(lambda lines: [lines[0].replace("seed,", "seed,seed,"), *lines[1:]]),
    "table with text in a row": _table(lambda lines: [*lines[:2], lines[2].replace(",", ",x", 1), *lines[3:]]),
    "table with a short row": _table(lambda lines: [*lines[:2], "40,0\n", *lines[3:]]),
    "table with an endless cell": _table(lambda lines: [*lines[:2], "9" * 200_000 + "\n", *lines[3:]]),
    "table that is a folder": lambda folder: (
        (folder / "metrics.csv").unlink(),
        (folder / "metrics.csv").mkdir(),
    ),
    "table that is a FIFO": lambda folder: (
        (folder / "metrics.csv").unlink(),
        os.mkfifo(folder / "metrics.csv"),
    ),
}
"""Damage to metrics.csv that loses rows of which the checkpoints are known."""

READABLE = {
    "table with line ends of Windows": _bytes(lambda data: data.replace(b"\n", b"\r\n")),
    "table with line ends of old Macs": _bytes(lambda data: data.replace(b"\n", b"\r")),
    "table with a byte order mark": _bytes(lambda data: b"\xef\xbb\xbf" + data),
    "table with blank lines": _bytes(lambda data: data.replace(b"\n", b"\n\n")),
}
"""Changes of metrics.csv after which all its rows can still be read."""


def _config(**changes):
    """Return a function that sets values of config.json; `None` removes one."""

    def damage(folder):
        path = folder / "config.json"
        values = {**json.loads(path.read_text()), **changes}
        path.write_text(json.dumps({name: value for name, value in values.items() if value is not None}))

    return damage


def _config_text(old, new):
    """Return a function that adds an entry to config.json, written as text because Python cannot write its value."""

    def damage(folder):
        path = folder / "config.json"
        values = json.loads(path.read_text())
        values[old] = "REPLACED"
        path.write_text(json.dumps(values).replace('"REPLACED"', new))

    return damage


CONFIG = {
    "config empty": lambda folder: (folder / "config.json").write_bytes(b""),
    "config of binary data": lambda folder: (folder / "config.json").write_bytes(bytes(range(256))),
    "config that is a list": lambda folder: (folder / "config.json").write_text("[]"),
    "config with 5000 brackets": lambda folder: (folder / "config.json").write_text("[" * 5000),
    "config with 5000 brackets in options": _config_text("options", "[" * 5000 + "]" * 5000),
    "config with 900 dictionaries in options": _config_text("options", '{"a":' * 900 + "1" + "}" * 900),
    "config with steps of 400 digits": _config_text("steps", "4" + "0" * 399),
    "config with steps of 5000 digits": _config_text("steps", "4" + "0" * 4999),
    "config with steps NaN": _config_text("steps", "NaN"),
    "config with steps as text": _config(steps="120"),
    "config with steps true": _config(steps=True),
    "config with eval_every of 400 digits": _config_text("eval_every", "4" * 400),
    "config with options of 400 digits": _config_text("options", '{"discount": ' + "9" * 400 + "}"),
    "config with options NaN": _config_text("options", '{"discount": NaN}'),
    "config with options as a list": _config(options=[]),
    "config with a seed of 400 digits": _config_text("seeds", "[" + "1" * 400 + "]"),
    "config with 70000 seeds": _config(seeds=list(range(70_000))),
    "config with seeds as a number": _config(seeds=5),
    "config with seeds NaN": _config_text("seeds", "[NaN]"),
    "config without seeds": _config(seeds=None),
    "config with an unknown task": _config(env="nowhere"),
    "config with an unknown method": _config(algo="nothing"),
    "config with a task as a number": _config(env=5),
    "config with a setting without a name": _config(setting={}),
    "config with an unknown setting": _config(setting={"name": 5}),
    "config with a class as a number": _config(env_class=5),
    "config with logs as a number": _config(logs=5),
    "config with logs as text": _config(logs="tensorboard"),
    "config of 17 MB": lambda folder: (folder / "config.json").write_text(" " * (17 << 20)),
}
DAMAGED = "config.json is damaged: "
CAUSES = {
    **dict.fromkeys(CONFIG, DAMAGED),
    "config with 900 dictionaries in options": f"{DAMAGED}'a' in options has more than 8 levels",
    "config with steps of 400 digits": f"{DAMAGED}steps must lie in [1, ",
    "config with steps NaN": "and seeds must be whole numbers, not [nan, ",
    "config with steps as text": "and seeds must be whole numbers, not ['120', ",
    "config with steps true": "and seeds must be whole numbers, not [True, ",
    "config with eval_every of 400 digits": f"{DAMAGED}eval_every must lie in [1, ",
    "config with options of 400 digits": f"{DAMAGED}'discount' in options is or holds a number that is too large",
    "config with options NaN": "algo 'naive': discount must be a finite number, not nan",
    "config with options as a list": f"{DAMAGED}options must be a dict, not []",
    "config with a seed of 400 digits": f"{DAMAGED}seeds must lie in [0, ",
    "config with 70000 seeds": f"{DAMAGED}at most 65536 seeds fit in one run",
    "config with seeds as a number": f"{DAMAGED}seeds must be a list",
    "config with seeds NaN": "and seeds must be whole numbers, not [120, 40, 2, 40, nan]",
    "config without seeds": f"{DAMAGED}it has no 'seeds'",
    "config with an unknown task": "unknown env 'nowhere'; choose from ",
    "config with an unknown method": "unknown algo 'nothing'; choose from ",
    "config with a task as a number": f"{DAMAGED}env must be a str, not 5",
    "config with a setting without a name": f"{DAMAGED}setting has no name: {{}}",
    "config with an unknown setting": "unknown setting 5; choose from deployment, continuing",
    "config with a class as a number": f"{DAMAGED}env_class must be text or null, not 5",
    "config with logs as a number": f"{DAMAGED}logs must be a list",
    "config with logs as text": f"{DAMAGED}logs must be a list",
    "config of 17 MB": "config.json is larger than 16 MiB, the limit",
}
"""What the message says of each damage to config.json; the wording of the JSON parser is not ours."""

LOGS = {
    "config with an unknown log": _config(logs=["abacus"]),
    "config with a log as a number": _config(logs=[5]),
}
"""Damage to config.json that concerns training only: tables and plots need no logs."""


def newest_checkpoint(folder):
    """Return the path of the newest checkpoint in a run folder."""
    return max(path for path in (folder / "checkpoints").iterdir() if path.name.isascii() and path.name.isdigit())


def _manifest(change):
    """Return a function that changes the manifest of the newest checkpoint, with a checksum that fits."""

    def damage(folder):
        path = newest_checkpoint(folder) / "manifest.json"
        body = json.loads(path.read_text())
        body.pop("checksum")
        path.write_text(manifest_text(change(body)))

    return damage


def _without(name):
    return lambda body: {key: value for key, value in body.items() if key != name}


CHECKPOINTS = {
    "manifest missing": lambda folder: (newest_checkpoint(folder) / "manifest.json").unlink(),
    "manifest that is a list": lambda folder: (newest_checkpoint(folder) / "manifest.json").write_text("[]"),
    "manifest with 5000 brackets": lambda folder: (newest_checkpoint(folder) / "manifest.json").write_text("[" * 5000),
    "manifest without a step": _manifest(_without("step")),
    "manifest without lanes": _manifest(_without("lanes")),
    "manifest without files": _manifest(_without("files")),
    "manifest with a step as text": _manifest(lambda body: {**body, "step": str(body["step"])}),
    "manifest with a step true": _manifest(lambda body: {**body, "step": True}),
    "manifest with lanes as a list": _manifest(lambda body: {**body, "lanes": []}),
    "manifest with files as pairs": _manifest(lambda body: {**body, "files": [[1, 2]]}),
    "manifest with a checksum as a number": _manifest(lambda body: {**body, "files": dict.fromkeys(body["files"], 5)}),
    "manifest with a file of a null character": _manifest(lambda body: {**body, "files": {"a\0b": ""}}),
    "checkpoint without its lanes": lambda folder: shutil.rmtree(newest_checkpoint(folder) / "lanes"),
    "checkpoint without its lanes and their names": lambda folder: (
        shutil.rmtree(newest_checkpoint(folder) / "lanes"),
        _manifest(lambda body: {**body, "files": {}})(folder),
    ),
    "checkpoint without its replay and its names": lambda folder: (
        shutil.rmtree(newest_checkpoint(folder) / "replay"),
        _manifest(lambda body: {**body, "files": {}})(folder),
    ),
}
"""Damage to the newest checkpoint, in place of which the one before it is used."""

IGNORED = {
    "checkpoint named by a superscript": lambda folder: (folder / "checkpoints/²").mkdir(parents=True),
    "checkpoint named in Arabic digits": lambda folder: (folder / "checkpoints/٠٠٠٠٠٠٩٩٩").mkdir(parents=True),
    "checkpoint named by a short number": lambda folder: (folder / "checkpoints/999").mkdir(parents=True),
    "checkpoint that is a file": lambda folder: (folder / "checkpoints/000000999").write_text("x"),
    "unfinished checkpoint": lambda folder: (folder / "checkpoints/part-999").mkdir(parents=True),
    "unfinished config": lambda folder: (folder / "config.json.part").write_text("{"),
}
"""Entries that no command takes for a checkpoint or a config."""


def _link(name, folder_target=False):
    """Return a function that puts a link to the victim at `name`, and keeps what is there under another name."""

    def damage(folder):
        path, victim = folder / name, victim_of(folder)
        path.parent.mkdir(parents=True, exist_ok=True)
        if folder_target:
            victim.mkdir()
            (victim / "file").write_text(SECRET)
        else:
            victim.write_text(SECRET)
        if path.is_dir():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        path.symlink_to(victim)

    return damage


LINKS = {
    **{
        f"link at {name}": _link(name)
        for name in (
            "config.json.part", "metrics.csv", "metrics.csv.part", "policies.npz", "policies.npz.part", ".lock",
            "checkpoints/part-999", "checkpoints/000000040",
        )
    },
    **{
        f"link at {name}": _link(name, folder_target=True)
        for name in ("checkpoints", "tensorboard", "wandb", "checkpoints/part-80", "checkpoints/part-120")
    },
    "link at tensorboard/events": _link("tensorboard/events.out.tfevents.0"),
}  # fmt: skip
"""Links where a run writes."""
