"""Damage to the folder of a finished run, of which each test damages a copy."""

import json


def _table(change):
    """Return a function that replaces the lines of metrics.csv by `change(lines)`."""
    return _bytes(lambda data: "".join(change(data.decode().splitlines(keepends=True))).encode())


def _bytes(change):
    def damage(folder):
        path = folder / "metrics.csv"
        path.write_bytes(change(path.read_bytes()))

    return damage


def _cell(column, value):
    """Return a function that puts `value` into the cells of a column, except those of the first row."""

    def change(lines):
        cells = [line.rstrip("\n").split(",") for line in lines]
        for row in cells[2:]:
            row[cells[0].index(column)] = value
        return [",".join(row) + "\n" for row in cells]

    return _table(change)


TABLE = {
    "table missing": lambda folder: (folder / "metrics.csv").unlink(),
    "table empty": _bytes(lambda data: b""),
    "table with its header only": _table(lambda lines: lines[:1]),
    "table of binary data": _bytes(lambda data: bytes(range(256)) * 40),
    "table without its second row": _table(lambda lines: lines[:2] + lines[3:]),
    "table without its last evaluations": _table(lambda lines: lines[:3]),
    "table with a seed of a fraction": _cell("seed", "0.5"),
    "table with a step of NaN": _cell("step", "nan"),
    "table with an open quote": _cell("faults", '"'),
    "table with null bytes": _bytes(lambda data: data.replace(b"0", b"\0")),
    "table with bytes that are no text": _bytes(lambda data: data.replace(b"0", b"\xff", 3)),
    "table without a header": _table(lambda lines: lines[1:]),
    "table with another header": _table(lambda lines: ["a,b,c\n", *lines[1:]]),
    "table with a column twice": _table(lambda lines: [lines[0].replace("seed,", "seed,seed,"), *lines[1:]]),
    "table with text in a row": _table(lambda lines: [*lines[:2], lines[2].replace(",", ",x", 1), *lines[3:]]),
    "table with a short row": _table(lambda lines: [*lines[:2], "40,0\n", *lines[3:]]),
    "table with an endless cell": _table(lambda lines: [*lines[:2], "9" * 200_000 + "\n", *lines[3:]]),
    "table that is a folder": lambda folder: ((folder / "metrics.csv").unlink(), (folder / "metrics.csv").mkdir()),
}
"""Damage to metrics.csv that loses rows of which the checkpoints are known."""

READABLE = {
    "table with line ends of Windows": _bytes(lambda data: data.replace(b"\n", b"\r\n")),
    "table with line ends of old Macs": _bytes(lambda data: data.replace(b"\n", b"\r")),
    "table with a byte order mark": _bytes(lambda data: b"\xef\xbb\xbf" + data),
    "table with blank lines": _bytes(lambda data: data.replace(b"\n", b"\n\n")),
}
"""Changes of metrics.csv after which all its rows can still be read."""

CONFIG = [
    ("options", "[" * 5000 + "]" * 5000, "config.json is damaged: "),
    ("options", '{"a":' * 900 + "1" + "}" * 900, "config.json is damaged: 'a' in options has more than 8 levels"),
    ("options", '{"discount": ' + "9" * 400 + "}", "'discount' in options is or holds a number that is too large"),
    ("options", '{"discount": NaN}', "method 'naive': discount must be a finite number, not nan"),
    ("options", "[]", "options must be a dict, not []"),
    ("steps", "4" + "0" * 399, "steps must lie in [1, "),
    ("steps", "4" + "0" * 4999, "config.json is damaged: "),
    ("steps", "121", "steps 121 is not a multiple of eval_every 40"),
    ("seeds", "5", "seeds must be a list"),
    ("seeds", "[NaN]", "seeds must be whole numbers, not [nan]"),
    ("reward_type", None, "it has no 'reward_type'"),
    ("env", "5", "env must be a str, not 5"),
    ("setting", "{}", "setting has no name: {}"),
    ("setting", '{"name": 5}', "the setting must be a name or an object of Setting, not 5"),
    ("env_class", "5", "env_class must be text or null, not 5"),
    ("env_options", '{"train_horizon": 3000000000}', "train_horizon must lie in [0, 2147483647]"),
    ("options", '{"name": "x"}', "there is no option 'name'"),
    ("logs", '"tensorboard"', "logs must be a list"),
    *(("format", text, f"written by another version of earl_jax: its format is {text},") for text in ("0", "2", "4")),
    ("format", "[3]", "is damaged: its format is [3], and this version of earl_jax reads 3"),
    ("format", None, "it names no format, and this version of earl_jax reads 3"),
    ("file", b"", "config.json is damaged: "),
    ("file", b"\xff" * 100_000, "config.json is damaged: UnicodeDecodeError: 'utf-8' codec can't decode byte 0xff"),
    ("file", b"[]", "config.json is damaged: "),
    ("file", b"\xef\xbb\xbf{}", "it names no format"),
    ("file", b" " * (17 << 20), "config.json is larger than 16 MiB, the limit"),
]
"""Entries of config.json, the text of another value (None removes the entry) or the bytes of the file, and the message."""


def set_entry(folder, key, text):
    """Set an entry of config.json to a value that is written as text, because Python cannot write all of them."""
    values = {**json.loads((folder / "config.json").read_text()), key: "REPLACED"}
    if text is None:
        del values[key]
    (folder / "config.json").write_text(json.dumps(values).replace('"REPLACED"', text or ""))


IGNORED = {
    "checkpoint named in Arabic digits": lambda folder: (folder / "checkpoints/٠٠٠٠٠٠٩٩٩").mkdir(parents=True),
    "checkpoint named by a short number": lambda folder: (folder / "checkpoints/999").mkdir(parents=True),
    "checkpoint that is a link": lambda folder: (folder / "checkpoints/000000999").symlink_to("000000120"),
    "checkpoint that is a file": lambda folder: (folder / "checkpoints/000000999").write_text("x"),
}
"""Entries that no command takes for a checkpoint."""


LINKED_FILES = [
    *(f"{name}{end}" for name in ("config.json", "metrics.csv", "policies.npz") for end in ("", ".part")),
    *(".lock", "checkpoints/000000040", "checkpoints/000000080/lanes", "tensorboard/events.out.tfevents.0"),
]
LINKED_FOLDERS = ["checkpoints", "tensorboard", "wandb", "checkpoints/000000120.part"]
"""Where a run writes, and a link can lead to a file or a folder that no command may change."""
