"""Run folders of a page: found below the given folders, pooled into lines, and left out with a cause."""

import json

import pytest

from earl_jax.report.html.line_style import lightened, shaded
from earl_jax.report.html.runs import gather
from earl_jax.report.html.writing import write_page
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


def test_a_line_names_the_options_of_its_variant(tmp_path):
    write_page_run(tmp_path / "a", "fbrl", rising(1, 1))
    write_page_run(tmp_path / "b", "fbrl", rising(1, 1), reward_scale=3.0)
    lines, _ = gather(find_runs([tmp_path]))
    assert sorted(line.variant for line in lines) == ["", "reward_scale=3.0"]
    assert {(line.group.env, line.group.algo) for line in lines} == {(TABLETOP, "fbrl")}


def test_variants_of_a_method_differ_in_shade_and_dash(tmp_path):
    for number, (scale, layer_norm) in enumerate([(3.0, True), (20.0, False), (3.0, False), (20.0, True)]):
        options = {"reward_scale": scale, "layer_norm": layer_norm}
        write_page_run(tmp_path / str(number), "fbrl", rising(1, 1), **options)
    lines, _ = gather(find_runs([tmp_path]))
    assert [line.curves.options["reward_scale"] for line in lines] == [3, 20, 3, 20]
    assert [line.dash for line in lines] == ["solid", "solid", "dash", "dash"]
    assert lines[0].light == lines[2].light != lines[1].light == lines[3].light


def test_shades_go_from_dark_to_light():
    assert shaded("#808080", 0, 1) == "#808080"
    assert shaded("#808080", 0, 2) < "#808080" < shaded("#808080", 1, 2)
    assert lightened("#333333") == "#A0A0A0"


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
    out = write_page([tmp_path], tmp_path / "page.html")
    text = out.read_text()
    assert str(broken) in text
    lines, left_out = gather([intact, broken])
    assert [run.path for run in lines[0].runs] == [intact]
    assert [entry.path for entry in left_out] == [broken]
    assert cause in left_out[0].cause
