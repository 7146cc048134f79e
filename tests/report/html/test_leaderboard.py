"""The leaderboard of a page: its runs stand among the rows that ship, and each once."""

import json
import shutil

from benchmarks import leaderboard as committed
from earl_jax.report.html.leaderboard import HERE, leaderboard
from earl_jax.report.html.lines import gather
from earl_jax.report.leaderboard import shipped_rows
from tests.report.run_files import DOOR, TABLETOP, constant, write_page_run


def table(*folders):
    """Return the leaderboard of a page of `folders`."""
    return leaderboard(gather(folders)[0])


def test_a_run_stands_in_its_place_among_the_rows_that_ship(tmp_path):
    run = write_page_run(tmp_path / "run", "fbrl", constant(0.5, 0.7), layer_norm=True)
    config = json.loads((run / "config.json").read_text())
    config["provenance"]["commit"] = "0123456789abcdef"
    (run / "config.json").write_text(json.dumps(config))
    board = table(run)
    [group] = board["groups"]
    assert board["left_out"] == []
    assert (group["env"], len(group["rows"])) == (TABLETOP, 1 + sum(row.env == TABLETOP for row in shipped_rows()))
    [place] = [number for number, row in enumerate(group["rows"]) if row["line"]]
    cells = dict(zip(board["head"], group["rows"][place]["texts"], strict=True))
    assert group["rows"][place]["name"] == ("fbrl", "layer_norm=True")
    assert cells["deployed [95 %]"].startswith("0.600 [")
    assert (cells["from"], cells["seeds"], cells["commit"]) == (HERE, "2", "012345678")
    scores = [float(row["texts"][3].split()[0]) for row in group["rows"]]
    assert scores == sorted(scores, reverse=True)


def test_a_run_of_another_task_or_with_other_options_is_not_ranked(tmp_path):
    wide = write_page_run(tmp_path / "wide", "fbrl", constant(0.5), env_options={"wide": True})
    fish = write_page_run(tmp_path / "fish", "naive", constant(3.0), env="fish_swim")
    door = write_page_run(tmp_path / "door", "naive", constant(0.5), env=DOOR)
    board = table(wide, fish, door)
    assert [line.group.env for line in board["left_out"]] == [TABLETOP]
    assert [group["env"] for group in board["groups"]] == [TABLETOP, DOOR]
    assert [sum(bool(row["line"]) for row in group["rows"]) for group in board["groups"]] == [0, 1]
    assert table(fish)["groups"] == []


def test_a_run_of_the_repository_is_shown_once(tmp_path):
    folder = next(path for path in committed.folders() if path.parts[-2:] == (DOOR, "r3l"))
    [group] = table(shutil.copytree(folder, tmp_path / "copy"))["groups"]
    rows = [(row["texts"][0], bool(row["line"])) for row in group["rows"] if row["name"][0] == "r3l"]
    assert sorted(rows) == [("EARL, 2022", False), (HERE, True)]
