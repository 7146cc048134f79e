"""Maps and videos of a page."""

import base64
import os
import re

import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.report.html import media
from earl_jax.report.html.lines import gather
from earl_jax.report.html.media import VideoEmbedder, maps
from tests.report.run_files import TABLETOP, rising, write_page_run

VIDEO = b"\0\0\0\x20ftypisom" + bytes(50)


def test_regular_videos_that_fit_are_embedded(tmp_path, monkeypatch):
    run = write_page_run(tmp_path / "run", "fbrl", rising(1, 1))
    for name in ("first.mp4", "second.mp4"):
        (run / name).write_bytes(VIDEO)
    (run / "large.gif").write_bytes(b"GIF89a" + bytes(200))
    os.symlink(run / "first.mp4", run / "link.mp4")
    monkeypatch.setattr(media, "LARGEST", 100)
    monkeypatch.setattr(media, "TOTAL", 100)
    videos, sentences = VideoEmbedder().videos(gather([run])[0][0])
    assert [video["name"] for video in videos] == ["first.mp4"]
    assert videos[0]["uri"] == "data:video/mp4;base64," + base64.b64encode(VIDEO).decode()
    causes = [re.search(r"(\w+\.\w+) is left out: (\w+ \w+ \w+)", text).groups() for text in sentences]
    assert causes == [("large.gif", "it has 0"), ("link.mp4", "it is not"), ("second.mp4", "the videos of")]


def test_maps_are_shares_of_visits_on_a_common_scale(tmp_path, monkeypatch):
    run = write_page_run(tmp_path / "run", "fbrl", rising(2, 1))
    (run / "checkpoints").mkdir()
    visits = np.zeros((2, 4, 4), int)
    visits[0, 3, 0], visits[1, 1, 1] = 3, 1
    monkeypatch.setattr(media, "load_visits", lambda folder: (make(TABLETOP), visits))
    lines, _ = gather([run])
    [drawn], sentences = maps(lines)
    assert sentences == []
    assert drawn["shares"][0] == [None, None, None, 0.75]
    assert drawn["shares"][1] == [None, 0.25, None, None]
    assert drawn["ends"] == [0.25, 0.75]
    assert drawn["covered"] == 1 / 16
    assert drawn["unit"] == "table units"
    np.testing.assert_allclose(drawn["bounds"], make(TABLETOP).map_bounds)


@pytest.mark.parametrize(
    ("env", "sentences"),
    [(TABLETOP, ["No map of 1 runs of fbrl: they have no policies.npz and no checkpoint."]), ("franka_kitchen", [])],
)
def test_runs_without_a_checkpoint_and_tasks_without_a_map_have_no_map(tmp_path, env, sentences):
    lines, _ = gather([write_page_run(tmp_path / "run", "fbrl", rising(2, 1), env=env)])
    assert maps(lines) == ([], sentences)


@pytest.mark.parametrize("error", [ValueError("it is damaged.\nDetails"), KeyError()])
def test_a_checkpoint_that_cannot_be_read_is_reported(tmp_path, monkeypatch, error):
    run = write_page_run(tmp_path / "run", "fbrl", rising(2, 1))
    (run / "checkpoints").mkdir()

    def load(folder):
        raise error

    monkeypatch.setattr(media, "load_visits", load)
    lines, _ = gather([run])
    cause = "it is damaged" if error.args else "KeyError"
    assert maps(lines) == ([], [f"No map of fbrl: {cause}."])
