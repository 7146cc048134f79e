"""The paper's experiments: their tasks, methods, lengths and horizons.

Source: Sharma et al. 2022, tables 1 and 2, figures 2, 4 and 5.
"""

from earl_jax.envs import PAPER_TASKS, make
from earl_jax.errors import InputError
from earl_jax.report.published import published_steps

METHODS = ("naive", "fbrl", "r3l", "vaprl", "oracle")

FIGURE2_TASKS = ("cheetah_run", "fish_swim")
FIGURE2_HORIZONS = (1_000, 2_000, 5_000, 10_000, 20_000, 100_000, 200_000)
"""H_T, the steps between resets."""
FIGURE2_STEPS = 1_000_000
"""Training steps, which the paper does not print: five lifetimes between resets at the longest horizon."""
FIGURE2_FINDINGS = {
    ("cheetah_run", True): "degrades",
    ("cheetah_run", False): "restored",
    ("fish_swim", True): "degrades",
    ("fish_swim", False): "degrades",
}
"""The paper's finding on the return as H_T grows, by task and `timeout_bootstrap`."""

FIGURE4_TASKS = ("tabletop_organization", "sawyer_peg", "minitaur_pen")
FIGURE4_METHODS = ("fbrl", "oracle")
FIGURE4_LARGER = {
    ("tabletop_organization", "distance"): "fbrl",
    ("tabletop_organization", "corners"): "fbrl",
    ("sawyer_peg", "distance"): "fbrl",
    ("sawyer_peg", "near_goal"): "oracle",
    ("minitaur_pen", "distance"): "fbrl",
}
"""The method with the larger value in the paper, by task and measure of visits. In its words the oracle stays around the
initial and goal distributions, the other agent goes further away and into the corners, and the oracle's peg is stuck
around the goal box."""
FIGURE4_GOAL_RADIUS = {"sawyer_peg": 0.12}
"""Distance in metres of a visit to a goal that counts as near, by task (ours): the block reaches 0.1 m from its middle."""
FIGURE5_TASKS = ("tabletop_organization",)
FIGURE5_METHODS = ("fbrl", "vaprl", "oracle")

TRADEOFF_TASKS = ("tabletop_organization", "sawyer_door")
TRADEOFF_METHODS = ("naive", "fbrl")
TRADEOFF_STEPS = 1_000_000
"""Training steps of the trade-off of the conclusion, for which the paper has no experiment; all its numbers are ours."""
TRADEOFF_CHANCES = (0.0, 1e-5, 1e-4, 1e-3, 5e-3)
"""epsilon: at the largest one an intervention follows after 200 steps on average, about as often as an episode ends."""
TRADEOFF_BUDGETS = (10.0, 100.0, 1_000.0)
"""h_max, at a cost of 1 for each intervention."""


def training_steps(env: str) -> int:
    """Return the steps that the paper trained for on one of `PAPER_TASKS`, the least where its runs differ."""
    steps = published_steps(env)
    if steps is None:
        raise InputError(f"no number of steps is published for {env!r}; choose from {', '.join(PAPER_TASKS)}")
    return steps[0]


def methods_on(env: str, methods: tuple[str, ...]) -> tuple[str, ...]:
    """Return those of `methods` that can run on a task: VaPRL needs demonstrations."""
    has_demos = make(env).has_demos
    return tuple(method for method in methods if has_demos or method != "vaprl")
