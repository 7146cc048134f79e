"""What the html page of runs is made of: folders, lines, numbers, maps, videos, commands."""

import base64
import dataclasses
import json
import os
import re
import shlex
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.protocol import Continuing, Deployment
from earl_jax.report.html import media
from earl_jax.report.html.curves import POINTS, banded, thinned
from earl_jax.report.html.media import Album, maps
from earl_jax.report.html.origin import command, settings
from earl_jax.report.html.runs import find, gather, lightened, shade
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.training import api as training
from tests.report.page.test_writing import TABLETOP, rising, write_run


def test_folders_are_found_once_however_they_are_named(tmp_path):
    write_run(tmp_path / "a" / "b", TABLETOP, "fbrl", rising(1, 1))
    write_run(tmp_path / "a" / "c" / "d", TABLETOP, "naive", rising(1, 1))
    (tmp_path / "a" / "b" / "checkpoints").mkdir()
    (tmp_path / "a" / "b" / "checkpoints" / "config.json").write_text("{}")
    assert find([tmp_path, tmp_path / "a" / "c" / ".." / "b"]) == [tmp_path / "a" / "b", tmp_path / "a" / "c" / "d"]
    assert find([tmp_path / "a" / "c" / "d"]) == [tmp_path / "a" / "c" / "d"]


def test_long_curves_are_thinned_with_both_ends_kept():
    kept = thinned(10_000)
    assert len(kept) == POINTS
    assert (kept[0], kept[-1]) == (0, 9_999)
    assert thinned(7).tolist() == list(range(7))
    assert banded(np.array([[1.0, np.nan]]))["mean"] == [1.0, None]


def test_seeds_that_count_twice_and_runs_that_don_t_fit_are_told(tmp_path):
    write_run(tmp_path / "a", TABLETOP, "fbrl", rising(2, 2))
    write_run(tmp_path / "b", TABLETOP, "fbrl", rising(2, 2), seeds=(1, 2))
    lines, left_out = gather(find([tmp_path]))
    assert (lines[0].seeds, left_out) == ((0, 1, 1, 2), [])
    shutil.move(tmp_path / "b" / "metrics.csv", tmp_path / "b" / "kept.csv")
    (tmp_path / "b" / "metrics.csv").write_text((tmp_path / "b" / "kept.csv").read_text().replace("reached", "other"))
    lines, left_out = gather(find([tmp_path]))
    assert lines[0].seeds == (0, 1)
    assert left_out[0].path == tmp_path / "b"
    assert "reached" in left_out[0].cause


def test_variants_of_a_method_differ_in_shade_and_dash(tmp_path):
    for number, (scale, layer) in enumerate([(3.0, True), (20.0, False), (3.0, False), (20.0, True)]):
        write_run(tmp_path / str(number), TABLETOP, "fbrl", rising(1, 1), reward_scale=scale, layer_norm=layer)
    lines, _ = gather(find([tmp_path]))
    looks = [(line.cell.curves.options["reward_scale"], line.dash, line.day) for line in lines]
    assert [scale for scale, _, _ in looks] == [3, 20, 3, 20]
    assert [dash for _, dash, _ in looks] == ["solid", "solid", "dash", "dash"]
    assert looks[0][2] == looks[2][2] != looks[1][2] == looks[3][2]
    assert shade("#808080", 0, 1) == "#808080"
    assert shade("#808080", 0, 2) < "#808080" < shade("#808080", 1, 2)
    assert lightened("#333333") == "#A0A0A0"


def test_videos_are_embedded_when_they_are_videos_and_fit(tmp_path, monkeypatch):
    run = write_run(tmp_path / "run", TABLETOP, "fbrl", rising(1, 1))
    good = b"\0\0\0\x20ftypisom" + bytes(50)
    (run / "video.mp4").write_bytes(good)
    (run / "fake.mp4").write_bytes(b"<script>")
    (run / "large.gif").write_bytes(b"GIF89a" + bytes(200))
    (tmp_path / "elsewhere.mp4").write_bytes(good)
    os.symlink(tmp_path / "elsewhere.mp4", run / "link.mp4")
    monkeypatch.setattr(media, "LARGEST", 100)
    lines, _ = gather([run])
    found, sentences = Album().videos(lines[0])
    assert [video["name"] for video in found] == ["video.mp4"]
    assert found[0]["uri"] == "data:video/mp4;base64," + base64.b64encode(good).decode()
    assert [re.search(r"(\w+\.\w+) is left out: (it \w+ \w+)", text).groups() for text in sentences] == [
        ("fake.mp4", "it is no"), ("large.gif", "it has 0"), ("link.mp4", "it is no"),
    ]  # fmt: skip
    monkeypatch.setattr(media, "TOGETHER", 10)
    assert "together" in Album().videos(lines[0])[1][-1]


def test_maps_are_shares_of_visits_on_a_common_scale(tmp_path, monkeypatch):
    run = write_run(tmp_path / "run", TABLETOP, "fbrl", rising(2, 1))
    lines, _ = gather([run])
    assert maps(lines) == ([], ["Without a checkpoint there is no map of visited places: 1 of these runs."])
    (run / "checkpoints").mkdir()
    visits = np.zeros((2, 4, 4), int)
    visits[0, 3, 0], visits[1, 1, 1] = 3, 1
    lanes = SimpleNamespace(visits=visits)
    monkeypatch.setattr(media, "load_lanes", lambda folder: (make(TABLETOP), None, lanes))
    drawn, sentences = maps(lines)
    assert sentences == []
    assert drawn[0]["shares"][0] == [None, None, None, 0.75]
    assert drawn[0]["shares"][1] == [None, 0.25, None, None]
    assert drawn[0]["ends"] == [0.25, 0.75]
    assert drawn[0]["covered"] == 1 / 16


@pytest.mark.parametrize(
    "setting", [Deployment(), Continuing(budget=2.0, goal_change=7)], ids=["deployment", "continuing"]
)
def test_the_command_of_a_run_trains_that_run(tmp_path, setting, monkeypatch):
    from earl_jax.cli import main as cli

    wide = {"hidden_sizes": (8, 8), "precision": "bf16", "reward_scale": 3.0}
    run = write_run(
        tmp_path / "run", TABLETOP, "fbrl", rising(2, 3), setting=setting, env_options={"wide": True}, **wide
    )
    one = RunFolder.open(run).config
    asked = {}
    monkeypatch.setattr(training, "train", lambda *names, **options: asked.update(options, names=names) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cli.main(shlex.split(command(one))[1:])
    env, method = asked["names"]
    counts = [asked[name] for name in ("steps", "eval_every", "eval_episodes", "checkpoint_every")]
    again = RunConfig.of(env, method, range(asked["seeds"]), *counts, asked["setting"])
    assert json.loads(json.dumps(dataclasses.asdict(again))) == json.loads(json.dumps(dataclasses.asdict(one)))
    changed = [row["name"] for row in settings(one) if row["changed"]]
    assert {"wide", "hidden_sizes", "precision", "reward_scale"} <= set(changed)
    assert len(settings(one)) > 2 * len(changed)
