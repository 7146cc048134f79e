"""The base class of methods: phases as data, and a few pure functions that the training loop calls.

The defaults are those of naive RL with episodes of H_E steps.
"""

import dataclasses
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.learner.base import Batch, Learner
from earl_jax.algos.learner.cloning import DemoSteps, clone
from earl_jax.algos.learner.replay import CONTROLLERS, TransitionBatch
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.pytree import OptionsNode
from earl_jax.assets import DIRECTIONS
from earl_jax.envs import Env
from earl_jax.envs.checks import require_like
from earl_jax.errors import InputError, brief, require_known
from earl_jax.options.values import COUNT, COUNT_OR_NEVER, Interval, check_intervals, require, require_object

TASK, RETURN = 0, 1
"""The indices of the two phases: reach the task goal, then return to prepare the next attempt."""


class PhaseDemos(NamedTuple):
    """The demonstrations of a `direction` that the controller of a phase uses, if the task has them.

    `every_goal`: the replay lists each transition once per task goal, for methods whose `prepare` assigns a task goal.
    `copies_per_step`: the replay lists each transition this often per later step of its demonstration, at least once.
    """

    direction: str
    every_goal: bool = False
    copies_per_step: float = 0.0


FORWARD, BACKWARD = PhaseDemos("forward"), PhaseDemos("backward")


@dataclasses.dataclass(frozen=True)
class Phase:
    """One of the phases between which a method alternates; the first one pursues the task.

    `controller`: the index of the controller that acts; `demos`: the demonstrations that it uses; `length`:
    steps until the phase times out, by default H_E; `ends_on_success`: reaching the goal ends the phase (sparse tasks
    only); `resets`: the end resets the environment; `has_goal`: metrics count whether the phase reaches its goal.
    """

    demos: tuple[PhaseDemos, ...] = (FORWARD,)
    controller: int = 0
    length: int | None = None
    ends_on_success: bool = True
    resets: bool = False
    has_goal: bool = True

    def __post_init__(self):
        given = self.demos
        if not isinstance(given, tuple) or not all(isinstance(demos, PhaseDemos) for demos in given):
            raise InputError(f"demos of a Phase must be a tuple of PhaseDemos, such as (FORWARD,), not {brief(given)}")
        for demos in given:
            require_known("direction of PhaseDemos", demos.direction, DIRECTIONS)
        require("the controller of a Phase", self.controller, COUNT_OR_NEVER)
        if self.length is not None:
            require("the length of a Phase", self.length, COUNT)


class Moment(NamedTuple):
    """Where a lane is before a step: `step` of its lifetime and `phase_step` of its `phase`, int32 [], counted from 0.

    `lane_key` is the lane's own key, which never changes, for draws that stay valid for more than one step.
    """

    step: jax.Array
    phase: jax.Array
    phase_step: jax.Array
    lane_key: jax.Array


class Method(OptionsNode):
    """A reset-free learning method: its phases, and functions of one lane. Float fields are vmappable leaves.

    Subclasses override what differs from naive RL. An override with other arguments, or with the arguments in another
    order, raises an error when the class is defined.
    """

    learner: Learner = SAC()

    name: ClassVar[str]
    needs_demos: ClassVar[bool] = False
    entropy_free_pairs: ClassVar[int] = 0
    """Number of pairs of critics without an entropy term, for methods that read `Learner.value`."""
    refresh_every: ClassVar[int] = 0
    """Steps between calls of `refresh`; 0 for never. If the number does not divide the steps of a chunk of training,
    the greatest common divisor of the two is used instead, and a warning says so."""
    refresh_batch_size: ClassVar[int] = 0
    """Number of the last controller's own transitions, without demonstrations, that `refresh` receives; 0 for none."""
    later_steps: ClassVar[int] = 0
    """Mean number of steps to the states `later` that `prepare` receives, for hindsight goals; 0 for none."""

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases in their order; after the last phase the first one follows."""
        return (Phase(),)

    def init(self, key: jax.Array, env: Env, goals: Goals) -> Any:
        """Return the initial state of the method itself, a pytree of learnt or remembered values; empty by default.

        Scalars [] in its dict `metrics`, an attribute or a key, become columns `METHOD/NAME` of metrics.csv.
        """
        return ()

    def pretrain(self, key: jax.Array, env: Env, agent: Any, demos: DemoSteps | None) -> Any:
        """Return `agent` (leading controller axis) before the first step, after `Learner.pretrain_steps` of cloning.

        `demos` is None if the method uses no demonstrations or the task has none.

        Raises:
            ValueError: there are steps of cloning, but `demos` is None.
        """
        if not self.learner.pretrain_steps:
            return agent
        if demos is None:
            raise InputError(
                f"{self.name} needs demonstrations to clone, and {env.name} has none; take another task, or "
                "pretrain_steps=0 to begin untrained"
            )
        actors, _ = clone(key, self.learner, agent.actor, demos)
        return jax.vmap(self.learner.with_actor)(agent, actors)

    def act(self, key: jax.Array, env: Env, actor: Any, obs: jax.Array, moment: Moment, method_state: Any) -> jax.Array:
        """Return the action [a] of the acting controller's `actor` at `obs [o]`, by default `Learner.act`."""
        return self.learner.act(key, actor, obs)

    def ends_phase(
        self, key: jax.Array, env: Env, agent: Any, obs: jax.Array, moment: Moment, method_state: Any
    ) -> jax.Array:
        """Return whether the phase times out after this step, bool []; by default after `Phase.length` steps.

        `obs [o]` is the observation before the step. `agent` has a leading controller axis; `select_controller` and
        `controller_of` select the acting controller.
        """
        lengths = [env.eval_horizon if phase.length is None else phase.length for phase in self.phases]
        return moment.phase_step + 1 >= of_phase(lengths, moment.phase)

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: Any
    ) -> GoalIndices:
        """Return the goals of a new `phase`: by default a random task goal, which can equal the `current` goal."""
        task = goals.draw_task(key)
        return GoalIndices(goal=task, task=task)

    def prepare(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array, method_state: Any
    ) -> TransitionBatch:
        """Return the sampled transitions of one lane, `batch [B]`, with the goals and rewards to learn from.

        The controller that acted in `phase` learns from them. A target does not bootstrap where `flags` say that the
        goal was reached, the lifetime ended or, without `Learner.timeout_bootstrap`, the phase timed out. With
        `Learner.cloning`, the rows that are still `demonstrated` in the result are cloned.
        """
        return batch

    def learn(
        self, key: jax.Array, env: Env, agent: Any, batch: Batch, phase: jax.Array, method_state: Any
    ) -> tuple[Any, Any, dict[str, jax.Array]]:
        """Return `agent` (the acting controller alone) and `method_state` after learning, and `Learner.diagnostics`."""
        updated = self.learner.update(key, agent, batch)
        known = agent, dict.fromkeys(self.learner.diagnostics, jnp.zeros(()))
        require_like(f"learner {self.learner.name}: update must return (agent, diagnostics)", updated, known)
        agent, diagnostics = updated
        return agent, method_state, diagnostics

    def refresh(
        self, key: jax.Array, env: Env, goals: Goals, agent: Any, batch: TransitionBatch | None, method_state: Any
    ) -> Any:
        """Return `method_state` refreshed with `agent` (leading controller axis), every `refresh_every` steps.

        `batch [refresh_batch_size]` contains own transitions of the last controller; its rows are `demonstrated` while
        that controller has none. It is None if `refresh_batch_size` is 0.
        """
        return method_state


def check_method(method: Method) -> None:
    """Raise an InputError if the learner, the phases or a member of `method` is invalid, or `refresh` never runs."""
    learner, phases = method.learner, method.phases
    if not isinstance(phases, tuple | list) or not phases or not all(isinstance(phase, Phase) for phase in phases):
        raise InputError(f"{method.name}: phases must be a tuple of one Phase or more, not {brief(phases)}")
    for name in ("refresh_every", "refresh_batch_size"):
        require(f"{method.name}: {name}", getattr(method, name), COUNT_OR_NEVER)
    if method.later_steps:
        require(f"{method.name}: later_steps", method.later_steps, Interval("[1, 1000000000]"))
    if type(method).refresh is not Method.refresh and not method.refresh_every:
        raise InputError(f"{method.name}: refresh is never called; set refresh_every to the steps between two calls")
    require_object("learner", learner, Learner, or_name=False)
    for options in (method, learner):
        check_intervals(method.name, options)


def controller_count(method: Method) -> int:
    """Return the number of separate agents of `method`, each with its own part of the replay.

    Raises:
        ValueError: there are more than the replay has parts.
    """
    count = 1 + max(phase.controller for phase in method.phases)
    if count > CONTROLLERS:
        raise InputError(f"{method.name} has {count} controllers, and the replay has parts for {CONTROLLERS}")
    return count


def controller_of(method: Method, phase: jax.Array) -> jax.Array:
    """Return the index of the controller that acts in `phase`."""
    index = of_phase([phase.controller for phase in method.phases], phase)
    return jnp.broadcast_to(jnp.asarray(index, jnp.int32), jnp.shape(phase))


def select_controller(agent: Any, index: jax.Array) -> Any:
    """Return controller `index` of `agent`, or of a part of it, without the leading axis; one alone needs no gather."""
    return jax.tree.map(lambda leaf: leaf[0] if leaf.shape[0] == 1 else leaf[index], agent)


def kept_transitions(method: Method) -> int | None:
    """Return the number of own transitions that the replay of a lane keeps for all controllers together; None: all."""
    each = method.learner.replay_capacity
    return None if each is None else each * controller_count(method)


def of_phase(values: list[Any], phase: jax.Array) -> Any:
    """Return the one of the static `values` that belongs to `phase []`, with as few operations as possible."""
    if all(value == values[0] for value in values):
        return values[0]
    if values == list(range(len(values))) and not isinstance(values[0], bool):
        return phase
    result = values[-1]
    for number, value in reversed(list(enumerate(values[:-1]))):
        result = jnp.where(phase == number, value, result)
    return result
