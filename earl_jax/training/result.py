"""The result of a run: its curves and policies, from training or from a run folder."""

import dataclasses
import functools
import html
import importlib
import textwrap
from pathlib import Path
from typing import Any

import jax
import numpy as np

from earl_jax.algos import Method
from earl_jax.envs import Env
from earl_jax.errors import InputError, brief, printable, require_known
from earl_jax.metrics.scores import DEFAULT, Score, Scores, Window, as_decimals, lifetime_scores
from earl_jax.options.seeds import lane_of
from earl_jax.runs.checkpoint import newest
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.training.loading import load_policies
from earl_jax.training.plan import per_lane
from earl_jax.training.policy import Policy, policies_of
from earl_jax.training.state import TrainState

MOST_SEEDS = 10
"""Largest number of seeds that a summary lists one by one."""


@dataclasses.dataclass(repr=False, eq=False)
class Result:
    """The result of a run: `steps [E]` of its evaluations, `metrics` of arrays [N, E] of N `seeds`, and its policies.

    Each seed was trained for `step` steps on the physics engine `engine`, which can be `kinematic`. If a time limit
    ended training early, `finished` is False. Before the first evaluation, `metrics` is empty. `folder` is the run
    folder or None. `train_state` is the final state, and `objects` are the trained task and method; `load` leaves both
    None and sets `run_id`.
    """

    config: RunConfig
    engine: str
    step: int
    steps: np.ndarray
    metrics: dict[str, np.ndarray]
    folder: RunFolder | None = None
    train_state: TrainState | None = None
    objects: tuple[Env, Method] | None = None
    run_id: str | None = None

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds, one for each lane."""
        return self.config.seeds

    @property
    def finished(self) -> bool:
        """Whether training reached its last step instead of being stopped by a time limit or a signal."""
        return self.step >= self.config.steps

    @functools.cached_property
    def env(self) -> Env:
        """The task, wrapped in a `HelpBudget` if the setting has a budget for help.

        Raises:
            ValueError: the run was loaded, and its task is not registered in this process.
        """
        return self.objects[0] if self.objects else self.config.build_env()

    @functools.cached_property
    def method(self) -> Method:
        """The method, with float leaves [N]. Errors as `env`."""
        return self.objects[1] if self.objects else per_lane(self.config.build_method(), len(self.seeds))

    def score(self, window: Window = DEFAULT, metric: str | None = None) -> Score:
        """Return the score of the run: the mean over seeds of the evaluations in `window`, by default the last tenth.

        `metric` is by default the deployed one. All seeds have equal weight, even if their hyper-parameters differ.

        Raises:
            ValueError: there is no evaluation yet, no such metric, or `window` is not a `Window`.
        """
        deployed = self.config.deployed_metric
        if self.metrics:
            require_known("metric", metric or deployed, self.metrics)
        return Score.of(self.steps, self.metrics, metric or deployed, deployed, window)

    @property
    def scores(self) -> Scores:
        """The paper's scores of the lifetimes: J_D, the mean of the deployed curve (for D(A)), and C(A).

        Raises:
            ValueError: there is no evaluation yet.
        """
        if not len(self.steps):
            raise InputError(f"there is no evaluation yet: training ended at step {self.step}")
        return lifetime_scores(self.steps, self.metrics, self.config.deployed_metric)

    @functools.cached_property
    def policies(self) -> Policy:
        """The greedy task policies of all seeds, one policy with leaves [N], for `jax.vmap`.

        Raises:
            ValueError: the run was loaded, and its folder has no policies or damaged ones, or now holds another run.
        """
        if self.train_state is not None:
            return policies_of(self.env, self.method, self.train_state.lanes)
        assert self.folder is not None
        if RunFolder.open(self.folder.path).recorded().get("id") != self.run_id:
            raise InputError(f"{self.folder.path} holds another run than when it was loaded; load it again")
        return load_policies(self.folder)

    def policy(self, lane: int = 0, *, seed: int | None = None) -> Policy:
        """Return the greedy task policy of `seed`, or of `seeds[lane]`, callable on obs [..., o] of the task without help.

        Raises:
            IndexError: there is no such lane.
            ValueError: there is no such seed, or as `policies`.
        """
        return select_seed(self.policies, lane if seed is None else lane_of(seed, self.seeds, "in this run"))

    def frame(self, *options: str) -> Any:
        """Return the metrics as a pandas DataFrame with the rows of metrics.csv: `step`, `seed`, and each metric.

        Each of `options` adds a column: `env`, `algo`, or an option of the task, the method or the setting, which shows
        its default if it was not given. Such columns identify the runs after their frames are concatenated.

        Raises:
            ValueError: pandas is not installed, there is no such option, or `method` raises it.
        """
        try:
            pandas = importlib.import_module("pandas")
        except ImportError as error:
            raise InputError("a frame needs pandas: pip install pandas") from error
        evaluations = len(self.steps)
        keys = {"step": np.repeat(self.steps, len(self.seeds)), "seed": np.tile(self.seeds, evaluations)}
        metrics = {name: values.T.ravel() for name, values in self.metrics.items()}
        chosen = {name: self._option_of_seeds(name) * evaluations for name in options}
        return pandas.DataFrame({**keys, **metrics, **chosen})

    def _option_of_seeds(self, name: str) -> list[Any]:
        """Return the value of an option for each seed. Errors as `frame`."""
        if name in ("env", "algo"):
            return [getattr(self.config, name)] * len(self.seeds)
        owners = (self.method, self.method.learner, self.env, self.config.build_setting())
        known = {field.name: owner for owner in reversed(owners) for field in dataclasses.fields(owner)}
        require_known("option", name, ["env", "algo", *known])
        value = getattr(known[name], name)
        return as_decimals(np.asarray(value)).tolist() if isinstance(value, jax.Array) else [value] * len(self.seeds)

    def summary(self, window: Window = DEFAULT) -> dict[str, str]:
        """Return a summary of the run and its scores, as printable texts by title."""
        config, scores = self.config.values, {}
        if len(self.steps) and self.config.deployed_metric in self.metrics:
            score = self.score(window)
            scores = {"score": str(score), "per seed": _numbers(np.array(score.scores))}
        texts = {
            "task": _with_options(config["env"], config["env_options"]),
            "method": _with_options(config["algo"], config["options"]),
            "setting": _with_options(config["setting"].pop("name"), config["setting"]),
            "seeds": _numbers(np.array(self.seeds)),
            "steps": f"{self.step:,} of {self.config.steps:,}, engine {self.engine}",
            **scores,
            "metrics": f"{len(self.metrics)} of shape [{len(self.seeds)}, {len(self.steps)}]: {', '.join(self.metrics)}",
            "folder": str(self.folder.path) if self.folder else "none",
        }
        return {title: printable(text) for title, text in texts.items()}

    def __repr__(self) -> str:
        wrapped = functools.partial(textwrap.fill, width=100, initial_indent="  ", subsequent_indent="    ")
        return "\n".join(["Result", *(wrapped(f"{title}: {text}") for title, text in self.summary().items())])

    def _repr_html_(self) -> str:
        cells = (f"<tr><th>{title}</th><td>{html.escape(text)}</td></tr>" for title, text in self.summary().items())
        return f"<table>{''.join(cells)}</table>"


def load(folder: str | Path) -> Result:
    """Return the run in `folder`: its config, its metrics and, on demand, its policies. No checkpoint is needed.

    Nothing is trained or compiled. The classes of method and task need not be registered, except for `Result.env` and
    `Result.method`, and for policies that were trained with a budget for help.

    Raises:
        ValueError: `folder` is not a run folder, or its config or its metrics are damaged; the message names the file.
    """
    run = RunFolder.open(folder)
    table = run.table()
    step = max(table.step, newest(run.checkpoints))
    recorded = run.recorded()
    engine, run_id = str(recorded.get("engine", "unknown")), recorded.get("id")
    return Result(run.config, engine, step, table.steps, table.metrics, run, run_id=run_id)


def select_seed(state: Any, i: int) -> Any:
    """Return lane `i` of `state`: the `LaneState` of a `TrainState`, or the lane of another tree with a lane axis.

    Raises:
        IndexError: there is no such lane.
        ValueError: `state` has no arrays with a lane axis.
    """
    lanes = state.lanes if isinstance(state, TrainState) else state
    leaves = jax.tree.leaves(lanes)
    if not leaves or not all(map(np.shape, leaves)):
        raise InputError(f"select_seed takes result.train_state or result.policies, not {brief(state)}")
    count = len(leaves[0])
    if not -count <= i < count:
        raise IndexError(f"no lane {i}: there are {count}, in the order of the seeds")
    return _lane(lanes, i)


@jax.jit
def _lane(lanes: Any, i: jax.Array) -> Any:
    """Return lane `i` with one program for all leaves."""
    return jax.tree.map(lambda leaf: leaf[i], lanes)


def _with_options(name: str, options: dict[str, Any]) -> str:
    text = ", ".join(f"{option}={value}" for option, value in options.items())
    return f"{name} ({text})" if text else name


def _numbers(values: np.ndarray) -> str:
    """Return `values [N]` as text: all of them if they are few, else the first and the last."""
    texts = [f"{value:.3g}" if isinstance(value, float) else str(value) for value in values.tolist()]
    return ", ".join(texts if len(texts) <= MOST_SEEDS else [*texts[:3], "...", *texts[-3:]])
