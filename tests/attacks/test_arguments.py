"""Values on the command line that mean nothing are refused before a folder is made."""

import pytest

from earl_jax.training import api
from tests.attacks.conftest import contents, refused
from tests.cli.process import TASK, run, training

DIGITS = "9" * 400
SETS = (
    "discount=1.5", "discount=nan", "discount=-Infinity", "discount=true", "discount=null", 'discount="0.9"', "discount=[]",
    "discount=[0.9,0.9,0.9]", "discount={}", f"discount={DIGITS}", "discount=" + "[" * 5000, "discount=" + '{"a":' * 5000,
    "learning_rate=0", "learning_rate=1e400", "learning_rate=x", "batch_size=1.5", "batch_size=1000000000000",
    f"random_steps={DIGITS}", "hidden_sizes=[]", "hidden_sizes=[0]", "hidden_sizes=[[16]]", "hidden_sizes=16",
    "train_horizon=3000000000", "name=x", "env=x", "seeds=3", "out=x", "self=1", "=1", "a", "a=b=c", "__class__=x", "sac=1",
    "budget=-1", "intervention_chance=1.1", "goal_change=0", "reward_type=x", "precision=fp4", "\0=1", "discount=\ud800", "😀=1",
)  # fmt: skip
TRAIN = {
    "--steps": ("0", "1.5", "", DIGITS, "3000000000000"),
    "--seeds": ("0", "-1", "1000000000", DIGITS),
    "--eval-every": ("0", "7", DIGITS),
    "--eval-episodes": ("0", "x", DIGITS),
    "--checkpoint-every": ("0",),
    "--devices": ("0", "-1", "1000"),
    "--setting": ("x",),
    "--engine": ("c", "x"),
    "--algo": ("", "../naive", "fbrl\n", "__init__"),
    "--log": ("x",),
    "--hosts": ("x", "a:1,-2,0", ",,"),
}
TASKS = ("", f"../{TASK}", "Tabletop_organization", "\n", "--", DIGITS)
OTHERS = (
    ("resume", "run", "--steps", "40"), ("resume", "run", "--steps", "121"), ("resume", "run", "--steps", DIGITS),
    ("resume", "run", "--devices", "1000"), ("resume", ""), ("resume", "run/metrics.csv"),
    ("evaluate", "run", "--episodes", "0"), ("evaluate", "run", "--seed", "-1"), ("evaluate", "run", "--seed", DIGITS),
    ("evaluate", "run", "--engine", "mjx"), ("evaluate", "run", "--starts", "x"),
    ("table", "x" * 256), ("table", "x/" * 3000), ("table", "run\x1b[31m"), ("table", "~"), ("table", "*"),
    ("table", "run", "--out", "x.exe"), ("table",), ("plot", "run", "--out", "x.exe"), ("plot", "run/config.json"),
    ("report", "run", "--out", "x.txt"), ("report", "run", "--out", "."), ("report", "nowhere"),
    ("reproduce", "table3"), ("reproduce", "table1", "--scale", "x"), ("reproduce", "table1", "--steps", "-1"),
    ("reproduce", "table1", "--seeds", "1000000000"), ("reproduce", "table1", "--set", "name=x"),
    ("render", "x"), ("demos", "x"), ("import-demos", "nowhere"), ("",),
)  # fmt: skip
CASES = [
    *([*training("new"), text] for text in SETS),
    *(["train", TASK, "--steps", "120", "--out", "new", option, value] for option in TRAIN for value in TRAIN[option]),
    *(["train", task, "--steps", "120", "--out", "new"] for task in TASKS),
    *OTHERS,
]


@pytest.mark.parametrize("arguments", CASES, ids=lambda arguments: ascii(" ".join(arguments))[-60:])
def test_arguments_without_a_meaning_are_refused(arguments, copy, monkeypatch):
    def train(*_):
        raise AssertionError("training started")

    monkeypatch.setattr(api, "run_program", train)
    before = contents(copy)
    code, _, err = run(*arguments)
    refused(code, err)
    assert contents(copy) == before
    assert not copy.with_name("new").exists()
