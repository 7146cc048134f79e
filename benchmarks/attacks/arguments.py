"""Options and numbers on the command line."""

import functools

from benchmarks.attacks.case import Case, Failure, refused_arguments
from benchmarks.attacks.place import TASK, TINY, Place

SECONDS, MEMORY_MB = 30.0, 1500.0
EXPECTED = "one line (or the parser's usage), exit code 2, no folder, within 30 s and 1.5 GB"
DIGITS = "9" * 400
SETS = (
    "discount=-0.1", "discount=1", "discount=1.5", "discount=1e308", "discount=nan", "discount=NaN", "discount=Infinity",
    "discount=-Infinity", "discount=true", "discount=null", 'discount="0.9"', "discount=[]", "discount=[0.9]",
    "discount=[0.9,0.9,0.9]", "discount={}", f"discount={DIGITS}", "discount=" + "[" * 5000, "discount=" + '{"a":' * 5000,
    "learning_rate=0", "learning_rate=-1", "learning_rate=NaN", "learning_rate=1e400", "learning_rate=x",
    "initial_temperature=0", "initial_temperature=-1", "initial_temperature=NaN", "reward_scale=NaN", "batch_size=0",
    "batch_size=-1", "batch_size=1.5", "batch_size=1000000000000", f"batch_size={DIGITS}", "random_steps=-1",
    f"random_steps={DIGITS}", "hidden_sizes=[]", "hidden_sizes=[0]", "hidden_sizes=[-1]", "hidden_sizes=[1.5]",
    "hidden_sizes=[1000000000]", "hidden_sizes=[[16]]", "hidden_sizes=x", "hidden_sizes=16", "hidden_sizes=null",
    "train_horizon=-1", "train_horizon=3000000000", f"train_horizon={DIGITS}", "train_horizon=1.5",
    "eval_horizon=0", "eval_horizon=-5", "eval_horizon=3000000000", "name=x", "env=x", "algo=x", "seeds=3", "steps=3",
    "out=x", "logs=x", "devices=2", "progress=1", "self=1", "cls=1", "=1", "=", "a", "a=b=c", "__class__=x", "sac=1", "task=x",
    "budget=-1", "budget=NaN", "intervention_chance=-0.1", "intervention_chance=1.1", "intervention_chance=NaN",
    "help_cost=-1", "goal_change=0", "goal_change=5", "reward_type=x", "reward_type=1", "precision=fp4", "\0=1",
    "discount=\ud800", "😀=1", " discount=0.9",
)  # fmt: skip
NUMBERS = {
    "--steps": ("0", "-1", "1.5", "x", "", "1e3", DIGITS, "3000000000000"),
    "--seeds": ("0", "-1", "1.5", "x", "1000000000", DIGITS),
    "--eval-every": ("0", "-40", "7", "x", DIGITS),
    "--eval-episodes": ("0", "-1", "x", "100000000000", DIGITS),
    "--checkpoint-every": ("0", "-1", "x"),
    "--devices": ("0", "-1", "x", "1000", DIGITS),
    "--setting": ("x", "", "Deployment"),
    "--engine": ("c", "x", ""),
    "--algo": ("x", "", "../naive", "fbrl\n", "__init__", DIGITS),
    "--log": ("x", "csv"),
    "--hosts": ("x", "a:1,2", "a:1,-2,0", "a:1,2,9,9", ",,"),
}
TASKS = (
    "",
    "x",
    "../tabletop_organization",
    "tabletop_organization/..",
    "Tabletop_organization",
    "\n",
    "--",
    "-",
    DIGITS,
)
OTHERS = (
    ("resume", "run", "--steps", "0"), ("resume", "run", "--steps", "-40"), ("resume", "run", "--steps", "40"),
    ("resume", "run", "--steps", "121"), ("resume", "run", "--steps", DIGITS), ("resume", "run", "--devices", "0"),
    ("resume", "run", "--devices", "-1"), ("resume", "run", "--devices", "1000"), ("resume", ""), ("resume", "run/metrics.csv"),
    ("evaluate", "run", "--episodes", "0"), ("evaluate", "run", "--episodes", "-1"), ("evaluate", "run", "--seed", "-1"),
    ("evaluate", "run", "--episodes", "100000000000"), ("evaluate", "run", "--seed", DIGITS),
    ("evaluate", "run", "--engine", "mjx"), ("evaluate", "run", "--starts", "x"),
    ("table", "run", "--last", "0"), ("table", "run", "--last", "-1"), ("table", "run", "--out", "x.exe"), ("table",),
    ("table", "run", "--out", "nowhere/x/../../x.txt"), ("plot", "run", "--out", "x.exe"), ("plot",), ("plot", "run/config.json"),
    ("report", "run", "--out", "x.txt"), ("report", "run", "--out", "."), ("report",), ("report", "nowhere"),
    ("sweep", "nowhere.toml"), ("sweep", "."), ("sweep", "run/config.json"), ("sweep", "/dev/null"),
    ("reproduce", "table3"), ("reproduce", "table1", "--scale", "x"), ("reproduce", "table1", "--tasks", "x"),
    ("reproduce", "table1", "--steps", "-1"), ("reproduce", "table1", "--seeds", "-1"),
    ("reproduce", "table1", "--seeds", "1000000000"),
    ("reproduce", "table1", "--max-lanes", "0"), ("reproduce", "table1", "--set", "name=x"),
    ("reproduce", "table1", "--devices", "0"), ("render", "x"), ("demos", "x"), ("import-demos", "nowhere"), ("", ), ("x",),
)  # fmt: skip
GRIDS = {
    "empty": "", "no toml": "= =", "brackets": "a = " + "[" * 5000, "no envs": 'algos = ["naive"]', "NaN": "steps = nan",
    "text for steps": 'envs = ["tabletop_organization"]\nalgos = ["naive"]\nsteps = "x"',
    "many seeds": 'envs = ["tabletop_organization"]\nalgos = ["naive"]\nsteps = 40\neval_every = 40\nseeds = 1000000000',
    "a long product": 'envs = ["tabletop_organization"]\nalgos = ["naive"]\nsteps = 40\neval_every = 40\n[options]\n' + "".join(
        f"{name} = [{', '.join(f'0.{digit}' for digit in range(1, 10))}]\n"
        for name in ("discount", "tau", "learning_rate", "reward_scale", "initial_temperature", "epsilon", "x", "y")
    ),
    "name outside": 'envs = ["../../x"]\nalgos = ["naive"]\nsteps = 40',
    "binary": "\x00\x01", "huge number": f'envs = ["tabletop_organization"]\nalgos = ["naive"]\nsteps = {DIGITS}',
}  # fmt: skip


def refuse(arguments: tuple[str, ...], place: Place) -> str:
    """Expect that a training command is refused and creates nothing."""
    how = refused_arguments(place.run(*arguments, seconds=SECONDS, memory_mb=MEMORY_MB))
    if any(place.path.iterdir()):
        raise Failure(f"{next(place.path.iterdir()).name} was created")
    return how


def refuse_beside_run(arguments: tuple[str, ...], place: Place) -> str:
    """Expect that a command about the finished run `run` is refused."""
    place.finished()
    return refused_arguments(place.run(*arguments, seconds=SECONDS, memory_mb=MEMORY_MB))


def refuse_grid(text: str, place: Place) -> str:
    """Expect that a grid is refused, without a run."""
    (place.path / "grid.toml").write_text(text)
    how = refused_arguments(place.run("sweep", "grid.toml", "--out", "out", seconds=SECONDS, memory_mb=MEMORY_MB))
    if (place.path / "out").exists():
        raise Failure("the folder of the sweep was created")
    return how


def short(text: str) -> str:
    """Return `text` in printable form, without its middle if it is long."""
    return ascii(text)[1:-1] if len(text) < 60 else f"{ascii(text[:30])[1:-1]}... of {len(text)} characters"


def cases() -> list[Case]:
    """Return a case for every value; the start of each command is valid."""
    trains = [("train", TASK, "--steps", "120", "--out", "run", "--set", *TINY, text) for text in SETS]
    trains += [
        ("train", TASK, "--out", "run", *(() if option == "--steps" else ("--steps", "120")), option, value)
        for option, values in NUMBERS.items()
        for value in values
    ]
    trains += [("train", task, "--steps", "120", "--out", "run") for task in TASKS]
    names = [*SETS, *(f"{option} {value}" for option, values in NUMBERS.items() for value in values), *TASKS]
    return [
        *(
            Case(f"train {short(name)}", EXPECTED, functools.partial(refuse, command), fast=number % 12 == 0)
            for number, (name, command) in enumerate(zip(names, trains, strict=True))
        ),
        *(
            Case(" ".join(map(short, command)) or "''", EXPECTED, functools.partial(refuse_beside_run, command))
            for command in OTHERS
        ),
        *(
            Case(f"sweep of a grid: {name}", EXPECTED, functools.partial(refuse_grid, text))
            for name, text in GRIDS.items()
        ),
    ]
