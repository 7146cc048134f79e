"""Run folders of a page: found below the given folders, pooled into lines, and left out with a cause."""

import json

import pytest

from earl_jax.report.html.lines import gather
from earl_jax.report.runs import find_runs
from tests.report.run_files import TABLETOP, rising, write_page_run


def test_folders_are_found_once_however_they_are_given(tmp_path):
    nested, deep = tmp_path / "a" / "b", tmp_path / "a" / "c" / "d"
    write_page_run(nested, "fbrl", rising(1, 1))
    write_page_run(deep, "naive", rising(1, 1))
    (nested / "checkpoints").mkdir()
    (nested / "checkpoints" / "config.json").write_text("{}")
    assert find_runs([tmp_path, tmp_path / "a" / "c" / ".." / "b"]) == [nested, deep]
    assert find_runs([deep]) == [deep]


def test_a_seed_of_two_runs_counts_twice(tmp_path):
    write_page_run(tmp_path / "a", "fbrl", rising(2, 2))
    write_page_run(tmp_path / "b", "fbrl", rising(2, 2), seeds=(1, 2))
    lines, left_out = gather(find_runs([tmp_path]))
    assert (lines[0].seeds, left_out) == ((0, 1, 1, 2), [])


def test_a_run_with_other_metrics_is_left_out_of_its_pool(tmp_path):
    write_page_run(tmp_path / "a", "fbrl", rising(2, 2))
    other = write_page_run(tmp_path / "b", "fbrl", rising(2, 2), seeds=(1, 2))
    (other / "metrics.csv").write_text((other / "metrics.csv").read_text().replace("reached", "other"))
    lines, left_out = gather(find_runs([tmp_path]))
    assert lines[0].seeds == (0, 1)
    assert left_out[0].path == other
    assert "reached" in left_out[0].cause


def test_variants_of_a_method_have_names_shades_and_dashes_of_their_own(tmp_path):
    for scale in (3.0, 20.0):
        write_page_run(tmp_path / str(scale), "fbrl", rising(1, 1), reward_scale=scale)
    lines, _ = gather(find_runs([tmp_path]))
    assert sorted(line.variant for line in lines) == ["reward_scale=20.0", "reward_scale=3.0"]
    assert {(line.group.env, line.group.algo) for line in lines} == {(TABLETOP, "fbrl")}
    assert [line.dash for line in lines] == ["solid", "dash"]
    assert lines[0].light != lines[1].light


@pytest.mark.parametrize(
    ("values", "cause"),
    [
        ({"algo": "ppo"}, "unknown algo 'ppo'; choose from"),
        ({"env": "maze"}, "unknown env 'maze'; choose from"),
        ({"options": {"precision": "int8"}}, "int8"),
        ({"options": {"discount": 2}}, "discount must lie in [0, 1), not 2"),
        ({"setting": {"name": "offline"}}, "offline"),
        ({"algo_class": "elsewhere:Method"}, "elsewhere:Method, which is not registered here"),
    ],
)
def test_a_run_that_cannot_be_built_here_costs_that_run_only(tmp_path, values, cause):
    intact = write_page_run(tmp_path / "intact", "fbrl", rising(2, 2))
    broken = write_page_run(tmp_path / "broken", "fbrl", rising(2, 2))
    config = json.loads((broken / "config.json").read_text())
    (broken / "config.json").write_text(json.dumps({**config, **values}))
    lines, left_out = gather([intact, broken])
    assert [run.path for run in lines[0].runs] == [intact]
    assert [entry.path for entry in left_out] == [broken]
    assert cause in left_out[0].cause
