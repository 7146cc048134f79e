"""Seeds as a user gives them, and their check, which configs and sweeps share."""

import numpy as np
import pytest

from earl_jax.errors import InputError
from earl_jax.options.seeds import MOST_SEEDS, seed_list
from earl_jax.runs.config import RunConfig
from earl_jax.sweeps import grid


@pytest.mark.parametrize(
    ("seeds", "expected"),
    [
        ("5", range(5)), ("5:10", range(5, 10)), ("3,5,8", [3, 5, 8]), ("1:3,8", [1, 2, 8]), ("4:5", [4]), ("3,", [3]),
        (3, range(3)),
        ([4, 2], [4, 2]), (np.array([5, 7]), [5, 7]), (range(2, 4), [2, 3]), (np.int64(2), [0, 1]),
        (MOST_SEEDS, range(MOST_SEEDS)), ([2**32 - 1], [2**32 - 1]),
    ],
)  # fmt: skip
def test_seeds_are_a_count_a_range_or_a_list_as_text_or_not(seeds, expected):
    assert seed_list(seeds) == tuple(expected)
    assert all(type(seed) is int for seed in seed_list(seeds))


@pytest.mark.parametrize(
    ("seeds", "message"),
    [
        *[(text, "seeds takes a count") for text in ("10:5", "5:5", "1:2:3", ",", "")],
        *[(text, "seeds: .* is not a whole number") for text in ("a", "5:", "1.5")],
        *[(seeds, "seeds must be whole numbers, not") for seeds in ([0.5, 1], 2.0, None, ["3"], True, [0, True])],
        *[(seeds, "seeds must be whole numbers, not") for seeds in (b"ab", {3: 1}, {3, 1})],
        *[(seeds, "seeds must name at least one, not") for seeds in (0, [], "0", -1)],
        *[(seeds, "seed [13] is given twice") for seeds in ([1, 1], "1,1", "0:5,3")],
        *[(seeds, "at most 65536 seeds fit in one run") for seeds in (10**12, "0:99999999999,1", range(10**30))],
        *[(seeds, r"seeds must lie in \[0, 4294967295\]") for seeds in ([-1], [2**32], "4294967295:4294967297")],
    ],
)
def test_other_seeds_are_refused(seeds, message):
    with pytest.raises(InputError, match=f"^{message}"):
        seed_list(seeds)


def test_a_config_which_every_run_has_and_a_grid_have_the_same_check(tmp_path):
    with pytest.raises(InputError, match=r"^seed 3 is given twice$"):
        RunConfig("tabletop_organization", {}, "naive", {}, (3, 3), 40, 40, 1, 40, "sparse")
    (tmp_path / "grid.toml").write_text("envs = 'e'\nalgos = 'a'\nseeds = [3, 3]")
    with pytest.raises(InputError, match=r"grid\.toml: seed 3 is given twice$"):
        grid.read(tmp_path / "grid.toml")
