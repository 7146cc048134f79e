"""The differences that could separate our runs from the published ones, and the pairs of runs that test them."""

import dataclasses

from benchmarks.paper.cells import FORMER_VAPRL, PEG, TABLETOP
from earl_jax.metrics.scores import CONTINUING, SUCCESS

DOOR, KITCHEN, MINITAUR, CHEETAH = "sawyer_door", "franka_kitchen", "minitaur_pen", "cheetah_run"
LIGHTBULB = "dhand_lightbulb"
PUBLISHED = ("published",)
"""The second side of a pair that tests ours against the released runs."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """Two sets of run folders below results/paper that differ in one thing; the seeds of a set are pooled, each once.

    They are compared by the `metric`, by default the deployed score. The second set may be `PUBLISHED`.
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    metric: str | None = None


@dataclasses.dataclass(frozen=True)
class Difference:
    """A difference `what` with its number in the review, the `pairs` that test it, and a `cell` that was to be run.

    Two differences that the same pair tests have a number of both.
    """

    number: str
    what: str
    pairs: tuple[Pair, ...] = ()
    cell: tuple[str, str] | None = None


BIASED = f"{CHEETAH}/naive/train_horizon_1000"
BOOTSTRAPPED = f"{CHEETAH}/naive/timeout_bootstrap-train_horizon_1000"
SHORTER = f"{CHEETAH}/naive/discount_0.98901-timeout_bootstrap-train_horizon_1000"
ALL_KEPT = "replay_capacity_None"
"""The variant of a cell whose replay keeps all transitions."""
KITCHEN_ORACLE = f"{KITCHEN}/oracle/{ALL_KEPT}"
"""The kitchen's oracle with the replay of its variants."""
RELEASED_REPLAY = "replay_capacity_1000000"
"""The variant with the released replay of a cell whose replay keeps all transitions."""
DENSE_AGAIN = (
    *(f"{KITCHEN}/{algo}" for algo in ("naive", "fbrl", "r3l", "oracle")), f"{LIGHTBULB}/naive", f"{LIGHTBULB}/oracle",
)  # fmt: skip
RUN_AGAIN = TABLETOP, DOOR, PEG, *DENSE_AGAIN
"""Tasks and cells that have the released replay, which is the default since 2026-11-27."""
KEEP_ALL = (
    *(f"{MINITAUR}/{algo}" for algo in ("naive", "fbrl", "r3l", "oracle")),
    *(f"{LIGHTBULB}/{algo}" for algo in ("fbrl", "r3l")),
)  # fmt: skip
"""Cells that keep all transitions, and of which a variant has the released replay."""
SCRIPT_OPTIONS = "random_steps_10000-replay_capacity_1000000-reward_scale_0.1"
HORIZONS = 1_000, 10_000, 200_000


def _ten_seeds(variant: str) -> tuple[str, str]:
    """Return the run of a variant with seeds 0 to 4 and that with seeds 5 to 9."""
    return variant, f"{variant}-seeds_5_to_9"


def _released(update: str, horizon: int) -> tuple[str, str]:
    """Return the run of the released script with an `update` and its further seeds, which trained longer."""
    return _ten_seeds(f"{CHEETAH}/naive/{SCRIPT_OPTIONS}{update}-train_horizon_{horizon}")


def _all_kept(cell: str) -> str:
    """Return the run of a cell whose replay keeps all transitions, as that of its variants does."""
    return f"{cell}/{ALL_KEPT}" if cell.startswith(RUN_AGAIN) else cell


def _both_scores(first: tuple[str, ...], second: tuple[str, ...]) -> tuple[Pair, ...]:
    """Return the tests of two sets by the deployed score and by the reward of the life."""
    return Pair(first, second), Pair(first, second, CONTINUING)


def _variants(cell: str, *names: str, base: str | None = None) -> tuple[Pair, ...]:
    """Return the tests of variants of a cell, against its run `base`, by default the cell, and against the released runs."""
    others = (base or cell,), PUBLISHED
    return tuple(pair for name in names for other in others for pair in _both_scores((f"{cell}/{name}",), other))


def _released_replay(cell: str) -> tuple[Pair, ...]:
    """Return the tests of a cell with the released replay, against all transitions kept and against the released runs."""
    seeds = cell, f"{cell}/seeds_10_to_19"
    return *_both_scores((_all_kept(cell),), seeds), *_both_scores(seeds, PUBLISHED)


def _replays(cell: str) -> tuple[Pair, ...]:
    """Return the tests of a replay of the released size that keeps the demonstrations, and those of the released one."""
    return *_both_scores((_all_kept(cell),), (f"{cell}/keep_demos_True",)), *_released_replay(cell)


RELEASED_BIASED, RELEASED_BOOTSTRAPPED = (
    tuple(_released(update, horizon) for horizon in HORIZONS) for update in ("", "-timeout_bootstrap")
)
AGAIN = {
    cell: f"{cell}/commit_{commit}"
    for cell, commit in (
        (f"{TABLETOP}/naive", "ed7009a"), (f"{TABLETOP}/vaprl", "ed7009a"), (f"{DOOR}/r3l", "24b5aba"),
        (f"{KITCHEN}/naive", "3591157"), (f"{KITCHEN}/naive/{ALL_KEPT}", "87f9604"), (f"{KITCHEN}/fbrl", "c7e2d9e"),
        (f"{KITCHEN}/r3l", "c7e2d9e"), (f"{KITCHEN}/oracle", "3591157"), (KITCHEN_ORACLE, "87f9604"),
        (f"{KITCHEN}/oracle/reward_scale_0.1", "fbeb891"), (f"{LIGHTBULB}/naive", "abf6b43"),
    )
}  # fmt: skip
"""Cells whose seeds were run again, and their earlier runs."""
BESIDE_VARIANTS = {algo: AGAIN[f"{KITCHEN}/{algo}"] for algo in ("fbrl", "r3l")}
"""The kitchen's runs with the released replay that have evaluations at the steps of their variants."""
VAPRL = {
    DOOR: ("no_nearest_fallback", "no_unmet_goals", ALL_KEPT),
    TABLETOP: ("no_unmet_goals", ALL_KEPT),
}
KITCHEN_SETTINGS = tuple(f"{KITCHEN}/fbrl/{name}" for name in (
    "unleashed", "shared", "shared_mean", "unleashed_shared_mean", "wide", "reward_scale_100", "shared_reward_scale_10",
    "unleashed_reward_scale_10", "temperature_0.01", "greedy",
))  # fmt: skip
"""Variants of FBRL in the kitchen with the release's 10,000 random steps, as `random_10000` has them."""
DIFFERENCES = (
    Difference("1", "FBRL from uniform starts: two controllers, or one agent for both directions"),
    Difference("2", "figure 2 with the release's script: reward scale 0.1, 10,000 random steps; the biased update", tuple(
        Pair(biased[seeds], bootstrapped[seeds])
        for seeds in (slice(None), slice(1, None))
        for biased, bootstrapped in zip(RELEASED_BIASED, RELEASED_BOOTSTRAPPED, strict=True)
    )),
    Difference("3", "the biased update at H_T = 1,000: the effective discount 0.98901, or rare large targets", (
        Pair((SHORTER,), (BIASED,)), Pair((SHORTER,), (BOOTSTRAPPED,)),
    )),
    Difference("4", "the peg's oracle without layer norm: reward scale, layer norm", (
        Pair((f"{PEG}/oracle/scale_10-seeds_20_to_29",), (f"{PEG}/oracle/scale_1-seeds_20_to_29",)),
        Pair((_all_kept(f"{PEG}/oracle"),), (f"{PEG}/oracle/reward_scale_1",)),
        Pair((f"{PEG}/oracle/seeds_5_to_14",), (f"{PEG}/oracle/layer_norm",)),
    )),
    Difference("5, 6", "VaPRL as it was: new goals that are met already, and the highest value where none reaches epsilon", tuple(
        Pair((f"{env}/vaprl/{FORMER_VAPRL}",), (f"{env}/vaprl/{name}",)) for env, names in VAPRL.items() for name in names
    )),
    Difference("7", "VaPRL on the door with the final model", cell=(DOOR, "vaprl")),
    Difference("8", "naive RL's goal for 1,000 steps; the release: 400, after 10,000 random steps", tuple(
        Pair((_all_kept(f"{TABLETOP}/naive"),), (f"{TABLETOP}/naive/{name}",))
        for name in ("episode_200", "episode_400", "random_10000")
    )),
    Difference("9", "FBRL in bf16, or in tf32", (Pair((_all_kept(f"{TABLETOP}/fbrl"),), (f"{TABLETOP}/fbrl/tf32",)),)),
    Difference("10", "our demonstrations, or the authors' recordings", tuple(
        Pair((ours,), (f"{env}/{algo}/demo_file_recorded{recorded}",))
        for env in (TABLETOP, DOOR, PEG)
        for algo, ours, recorded in (
            ("vaprl", f"{env}/vaprl/{FORMER_VAPRL}", f"-{FORMER_VAPRL}"), ("fbrl", _all_kept(f"{env}/fbrl"), ""),
        )
    )),
    Difference("11", "naive RL on the door: a goal for 1,000 steps; the release: 400, after 10,000 random steps; its replay", (
        Pair((_all_kept(f"{DOOR}/naive"),), (f"{DOOR}/naive/episode_400-random_10000",)),
        *_replays(f"{DOOR}/naive"), Pair((_all_kept(f"{DOOR}/naive"),), PUBLISHED),
    )),
    Difference("12", "R3L's life on tabletop: terminal time-outs; the novelty, its scale; no demonstrations to perturb with", (
        *(
            Pair((_all_kept(f"{TABLETOP}/r3l"),), tuple(f"{TABLETOP}/r3l/{name}" for name in names), CONTINUING)
            for names in (("timeout_bootstrap",), _ten_seeds("error_scale"), ("perturbation_demos",))
        ),
        Pair((f"{TABLETOP}/r3l",), (f"{TABLETOP}/r3l/object_novelty",), CONTINUING),
    )),
    Difference("13", "the kitchen's life: weight; reward; random steps; float32; entropy; backward goal; updates; ends", (
        *(
            Pair((_all_kept(f"{KITCHEN}/{algo}"),), (f"{KITCHEN}/{algo}/unweighted_light",), CONTINUING)
            for algo in ("fbrl", "r3l")
        ),
        *(
            Pair((f"{KITCHEN}/{algo}/unweighted_light",), (f"{KITCHEN}/{algo}/reward_scale_{scale}",), CONTINUING)
            for scale in ("0.1", "10") for algo in ("fbrl", "r3l")
        ),
        *(
            Pair((_all_kept(f"{KITCHEN}/fbrl"),), (f"{KITCHEN}/fbrl/{name}",), CONTINUING)
            for name in ("random_10000", "precision_float32", "entropy_per_action_-1", "one_pair")
        ),
        *(
            Pair((BESIDE_VARIANTS[algo],), _ten_seeds(f"{KITCHEN}/{algo}/{name}"), CONTINUING)
            for algo, name in (
                ("fbrl", "both"), ("fbrl", "success"), ("fbrl", "both_success"), ("fbrl", "both_mean_return"),
                ("fbrl", "timeout_bootstrap"), ("r3l", "timeout_bootstrap"),
            )
        ),
        *(
            Pair((BESIDE_VARIANTS[algo],), (f"{KITCHEN}/{algo}/{name}",), CONTINUING)
            for algo, name in (("fbrl", "both_success-timeout_bootstrap"), ("r3l", "both"))
        ),
        *_both_scores((_all_kept(f"{KITCHEN}/fbrl"),), (f"{KITCHEN}/fbrl/mean_return",)),
        Pair((f"{KITCHEN}/fbrl/mean_return",), PUBLISHED, CONTINUING),
    )),
    Difference("14", "VaPRL's life on the door: the release's replay; reachable subgoals; relabelled demonstrations alone", (
        *_replays(f"{DOOR}/vaprl"), *_variants(f"{DOOR}/vaprl", "reachable", "demo_relabelling"),
    )),
    Difference("15", "the Minitaur's oracle and R3L: reward; ends at success; no randomisation; bootstrapped time-outs", (
        *(
            Pair((f"{MINITAUR}/{algo}",), (f"{MINITAUR}/{algo}/{name}",))
            for name in ("reward_scale_1", "terminate_on_success") for algo in ("oracle", "r3l")
        ),
        Pair((f"{MINITAUR}/oracle",), (f"{MINITAUR}/oracle/terminate_on_success",), SUCCESS),
        *(
            Pair((f"{MINITAUR}/oracle",), (f"{MINITAUR}/oracle/{name}",))
            for name in ("no_randomize", "no_randomize-reward_scale_1")
        ),
        Pair((f"{MINITAUR}/oracle",), (f"{MINITAUR}/oracle/variant_paper",), SUCCESS),
        *(
            Pair((f"{MINITAUR}/{algo}/{RELEASED_REPLAY}",), (f"{MINITAUR}/{algo}/timeout_bootstrap",), metric)
            for algo in ("oracle", "r3l") for metric in (None, SUCCESS)
        ),
    )),
    Difference("16", "the kitchen's oracle: the light's weight, with both of its runs; the release's reward scale 0.1", (
        Pair((KITCHEN_ORACLE, AGAIN[KITCHEN_ORACLE]), (f"{KITCHEN}/oracle/unweighted_light",)),
        Pair((KITCHEN_ORACLE,), (f"{KITCHEN}/oracle/reward_scale_0.1",)),
        Pair((f"{KITCHEN}/oracle/reward_scale_0.1",), PUBLISHED),
    )),
    Difference("17", "the same seeds again: the kept run, or an earlier one", tuple(
        Pair((cell,), (earlier,)) for cell, earlier in AGAIN.items()
    )),
    Difference("18", "VaPRL outperforms the oracle and R3L: with both runs of what ran twice", (
        Pair((f"{TABLETOP}/vaprl", AGAIN[f"{TABLETOP}/vaprl"]), (f"{TABLETOP}/oracle",)),
        Pair((f"{DOOR}/vaprl",), (f"{DOOR}/r3l", AGAIN[f"{DOOR}/r3l"])),
    )),
    Difference("19", "the release's replay: the other cells of tabletop, door and peg; dense tasks", (*(
        pair
        for env, algos in (
            (TABLETOP, ("naive", "vaprl", "fbrl", "r3l", "oracle")), (DOOR, ("fbrl", "r3l", "oracle")),
            (PEG, ("naive", "vaprl", "fbrl", "r3l", "oracle")),
        )
        for algo in algos
        for pair in _released_replay(f"{env}/{algo}")
    ), *(
        pair for cell in KEEP_ALL for pair in _both_scores((cell,), (f"{cell}/{RELEASED_REPLAY}",))
    ), *(
        pair for cell in DENSE_AGAIN for pair in _both_scores((_all_kept(cell),), (cell,))
    ))),
    Difference("20", "FBRL on the door on engine mjx", _both_scores((f"{DOOR}/fbrl",), (f"{DOOR}/fbrl/mjx",))),
    Difference("21", "the kitchen's backward goal of 13 on fresh seeds, with the released replay", (
        *_both_scores((BESIDE_VARIANTS["fbrl"],), (f"{KITCHEN}/fbrl/mean_return-seeds_5_to_9",)),
        Pair((f"{KITCHEN}/fbrl/mean_return-seeds_5_to_9",), PUBLISHED, CONTINUING),
    )),
    Difference("22", "figure 2 with the release's script to its 3M steps, fresh seeds; the biased update", tuple(
        Pair((f"{biased[0]}-seeds_10_to_14",), (f"{bootstrapped[0]}-seeds_10_to_14",))
        for biased, bootstrapped in zip(RELEASED_BIASED, RELEASED_BOOTSTRAPPED, strict=True)
    )),
    Difference("23", "the bootstrapped time-outs of 15 on fresh seeds, with the released replay", tuple(
        Pair(*((f"{MINITAUR}/{algo}/{name}-seeds_5_to_9",) for name in (RELEASED_REPLAY, "timeout_bootstrap")), metric)
        for algo in ("oracle", "r3l") for metric in (None, SUCCESS)
    )),
    Difference("24", "VaPRL's life on the door: the release's search; reachable subgoals; relabelled demonstrations alone", (
        _variants(f"{DOOR}/vaprl", "dual", "dual_reachable", "dual_demos")
    )),
    Difference("25", "the last setting of 24 on tabletop", _variants(f"{TABLETOP}/vaprl", "dual_demos")),
    Difference("26", "the last setting of 24 on fresh seeds", _variants(f"{DOOR}/vaprl", "dual_demos-seeds_10_to_14")),
    Difference("27", "FBRL's life in the kitchen with more released settings: motion, one agent, goal, deviations; others", tuple(
        pair
        for variant in KITCHEN_SETTINGS
        for pair in (
            Pair((f"{KITCHEN}/fbrl/random_10000",), (variant,), CONTINUING), Pair((variant,), PUBLISHED, CONTINUING)
        )
    )),
    Difference("28", "FBRL in the kitchen with VaPRL's released settings at once, fresh seeds", (
        _variants(f"{KITCHEN}/fbrl", "released", base=BESIDE_VARIANTS["fbrl"])
    )),
    Difference("29", "the same, with everything closed as the backward goal", (
        _variants(f"{KITCHEN}/fbrl", "released_closed", base=BESIDE_VARIANTS["fbrl"])
    )),
    Difference("30", "naive RL in the kitchen with the settings of 28 that it has, fresh seeds", (
        _variants(f"{KITCHEN}/naive", "released")
    )),
    Difference("31", "R3L in the kitchen with the settings of 28 that it has, fresh seeds", (
        _variants(f"{KITCHEN}/r3l", "released", base=BESIDE_VARIANTS["r3l"])
    )),
    Difference("32", "R3L on tabletop with the paper's reward scale of 1, fresh seeds; also with its entropy and time-outs", (
        _variants(f"{TABLETOP}/r3l", "reward_scale_1", "entropy_per_action_-1-reward_scale_1-timeout_bootstrap")
    )),
    Difference("33", "R3L on the door with the paper's reward scale of 1, fresh seeds", (
        _variants(f"{DOOR}/r3l", "reward_scale_1")
    )),
    Difference("34", "R3L in the kitchen as in 31, with a reset every 20,000 steps, fresh seeds", (
        _variants(f"{KITCHEN}/r3l", "released_resets", base=f"{KITCHEN}/r3l/released")
    )),
    Difference("35", "the kitchen's oracle, fresh seeds: deviations; random steps too, and with reward scale 0.1; motion", tuple(
        Pair((f"{KITCHEN}/oracle/{variant}",), other)
        for variant, base in (
            ("wide", ""), ("random_10000-wide", "/wide"), ("random_10000-reward_scale_0.1-wide", "/random_10000-wide"),
            ("unleashed-wide", "/wide"),
        )
        for other in ((f"{KITCHEN}/oracle{base}",), PUBLISHED)
    )),
)  # fmt: skip
