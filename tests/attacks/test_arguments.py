"""Values on the command line that mean nothing are refused before a folder is made."""

import pytest

from tests.attacks.conftest import refused
from tests.cli.process import TASK, run, unchanged

pytestmark = pytest.mark.usefixtures("no_training")
DIGITS = "9" * 400
SETS = (
    "discount=nan", "discount=NaN", "discount=-Infinity", "discount=true", "discount=null", 'discount="0.9"', "discount=[]",
    "discount=[0.9,0.9,0.9]", "discount={}", "learning_rate=1e400", "initial_temperature=-1", "batch_size=0",
    "batch_size=1000000000000", f"random_steps={DIGITS}", "hidden_sizes=[[16]]", "hidden_sizes=16", "hidden_sizes=null",
    "train_horizon=-1", "train_horizon=3000000000", "eval_horizon=0", "name=x", "env=x", "seeds=3", "out=x", "self=1", "=1",
    "a", "a=b=c", "__class__=x", "budget=-1", "help_cost=-1", "reward_type=x", "\0=1", "discount=\ud800", "😀=1", " discount=0.9",
)  # fmt: skip
NUMBERS = {
    "--set": SETS,
    "--steps": ("0", "-1", "1.5", "x", "", DIGITS, "3000000000000"),
    "--seeds": ("0", "-1", "x", "1000000000", DIGITS),
    "--eval-every": ("0", "7", "x", DIGITS),
    "--eval-episodes": ("0", "x", DIGITS),
    "--checkpoint-every": ("0", "x"),
    "--devices": ("0", "-1", "1000"),
    "--setting": ("x", "Deployment"),
    "--engine": ("c", "x"),
    "--algo": ("x", "", "../naive", "fbrl\n", "__init__"),
    "--log": ("x",),
    "--hosts": ("x", "a:1,2", "a:1,-2,0", ",,"),
}
TASKS = ("", "x", f"../{TASK}", f"{TASK}/..", "Tabletop_organization", "\n", "--", "-", DIGITS)
OTHERS = (
    ("resume", "run", "--steps", "40"), ("resume", "run", "--steps", "121"), ("resume", "run", "--steps", DIGITS),
    ("resume", "run", "--devices", "1000"), ("resume", ""), ("resume", "run/metrics.csv"),
    ("evaluate", "run", "--episodes", "0"), ("evaluate", "run", "--seed", "-1"), ("evaluate", "run", "--seed", DIGITS),
    ("evaluate", "run", "--engine", "mjx"), ("evaluate", "run", "--starts", "x"),
    ("table", "run", "--last", "0"), ("table", "run", "--out", "x.exe"), ("table",), ("plot", "run", "--out", "x.exe"), ("plot",),
    ("plot", "run/config.json"), ("report", "run", "--out", "x.txt"), ("report", "run", "--out", "."), ("report", "nowhere"),
    ("table", ""), ("reproduce", "table3"), ("reproduce", "table1", "--scale", "x"), ("reproduce", "table1", "--steps", "-1"),
    ("reproduce", "table1", "--seeds", "1000000000"),
    ("render", "x"), ("demos", "x"), ("import-demos", "nowhere"), ("",), ("x",),
)  # fmt: skip


def shown(value):
    """Return a short printable name of a case."""
    return ascii(value)[:60]


@pytest.mark.parametrize(
    "arguments",
    [(TASK, option, value) for option, values in NUMBERS.items() for value in values] + [(task,) for task in TASKS],
    ids=shown,
)
def test_an_option_number_or_name_without_a_meaning_is_refused(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(run("train", arguments[0], "--steps", "120", "--out", "run", *arguments[1:]))
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("arguments", OTHERS, ids=shown)
def test_arguments_of_other_commands_are_refused_and_change_nothing(arguments, copy):
    with unchanged(copy, but=".lock"):
        refused(run(*arguments))
