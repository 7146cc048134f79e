"""Maps of visits, videos in run folders, and videos of policies."""

import base64
import os

import numpy as np
import pytest

from earl_jax import rendering
from earl_jax.envs import make
from earl_jax.errors import InputError
from earl_jax.report.html import media
from earl_jax.report.html.media import PolicyVideos, maps, videos
from tests.report.html.conftest import read_lines
from tests.report.run_files import TABLETOP, constant, rising, write_page_run

VIDEO = b"\0\0\0\x20ftypisom" + bytes(50)


@pytest.fixture
def run(tmp_path):
    """A run of three seeds, of which seed 1 is the median, with policies at step 20."""
    folder = write_page_run(tmp_path / "run", "fbrl", rising(3, 2))
    (folder / "policies.npz").write_text("20")
    return folder


def test_regular_videos_that_fit_are_embedded(run, monkeypatch):
    for name in ("first.mp4", "second.mp4"):
        (run / name).write_bytes(VIDEO)
    (run / "large.gif").write_bytes(b"GIF89a" + bytes(200))
    os.symlink(run / "first.mp4", run / "link.mp4")
    monkeypatch.setattr(media, "LARGEST", 100)
    monkeypatch.setattr(media, "TOTAL", 100)
    first, *others = videos(read_lines(run))
    assert (first.name, first.problem) == ("first.mp4", "")
    assert first.uri == "data:video/mp4;base64," + base64.b64encode(VIDEO).decode()
    assert [video.uri for video in others] == [""] * 3
    causes = {"large.gif": "it has 0 MB", "link.mp4": "it is not", "second.mp4": "the videos"}
    for (name, cause), video in zip(causes.items(), others, strict=True):
        assert f"{name} is left out: {cause}" in video.problem


@pytest.fixture
def rendered(monkeypatch):
    """The arguments of each rendering, which writes a video of a few bytes."""
    calls = []

    def render(source, out, acting, **options):
        calls.append((source, acting, options["seed"], options["steps"]))
        out.write_bytes(VIDEO)
        return out

    monkeypatch.setattr(rendering, "render", render)
    monkeypatch.setattr(media, "policies_step", lambda path: int(path.read_text()))
    return calls


def test_a_page_has_the_policy_of_the_median_seed_which_is_rendered_once(run, rendered, tmp_path):
    scores = constant(0.9, 0.1, 0.5, 0.4)
    other = write_page_run(tmp_path / "other", "fbrl", scores, seeds=range(3, 7))
    (other / "policies.npz").write_text("20")
    told = []
    lines, policies = read_lines(run, other), PolicyVideos(told.append)
    for _ in range(3):
        shown = videos(lines, policies)
    names = [f"policy of seed {seed}, the median of {of}, at step 20" for seed, of in ((1, 3), (6, 4))]
    assert [(video.name, video.problem) for video in shown] == [(name, "") for name in names]
    assert all(video.uri.startswith("data:video/mp4;base64,") for video in shown)
    steps = round(6 / make(TABLETOP).view.dt)
    assert rendered == [(run, "policy", 1, steps), (other, "policy", 6, steps)]
    assert len(told) == 2
    (run / "policies.npz").write_text("30000")
    assert [video.name.partition(", at ")[2] for video in videos(lines, policies)] == ["step 30,000", "step 20"]
    assert len(rendered) == 3
    assert sorted(path.name for path in run.iterdir() if path.suffix) == ["config.json", "metrics.csv", "policies.npz"]
    assert videos(lines) == []


def test_a_run_without_a_video_is_named_with_the_cause(run, rendered, monkeypatch):
    def fail(*arguments, **options):
        rendered.append(arguments)
        raise InputError("no way to draw without a display: install EGL\nmore")

    monkeypatch.setattr(rendering, "render", fail)
    lines, policies = read_lines(run), PolicyVideos()
    cause = f"No video of the policy of {run}: no way to draw without a display: install EGL."
    assert [video.problem for _ in range(2) for video in videos(lines, policies)] == [cause] * 2
    assert len(rendered) == 1
    (run / "policies.npz").unlink()
    assert videos(lines, policies)[0].problem == f"No video of the policy of {run}: it has no policies.npz."


def test_maps_are_shares_of_visits_on_a_common_scale(run, monkeypatch):
    visits = np.zeros((3, 4, 4), int)
    visits[0, 3, 0], visits[1, 1, 1] = 3, 1
    monkeypatch.setattr(media, "load_visits", lambda folder: (make(TABLETOP), visits))
    [drawn], sentences = maps(read_lines(run))
    assert sentences == []
    plot = drawn["plot"]
    assert plot["shares"][:2] == [[None, None, None, 0.75], [None, 0.25, None, None]]
    assert (plot["ends"], plot["unit"], drawn["covered"]) == ([0.25, 0.75], "table units", 1 / 24)
    np.testing.assert_allclose(plot["bounds"], make(TABLETOP).map.bounds)


def test_the_seeds_of_one_run_that_have_values_of_their_own_have_maps_and_videos_apart(tmp_path, rendered, monkeypatch):
    scores = constant(0.9, 0.1, 0.5)
    run = write_page_run(tmp_path / "run", "fbrl", scores, seeds=(4, 5, 6), learning_rate=[1e-3, 1e-4, 1e-3])
    (run / "policies.npz").write_text("20")
    monkeypatch.setattr(media, "load_visits", lambda run: (make(TABLETOP), np.eye(9, dtype=int)[:3].reshape(3, 3, 3)))
    lines = read_lines(run)
    assert [line.seeds for line in lines] == [(4, 6), (5,)]
    videos(lines, PolicyVideos())
    assert [seed for _, _, seed, _ in rendered] == [6, 5]
    shares = [[share for row in drawn["plot"]["shares"] for share in row if share] for drawn in maps(lines)[0]]
    assert shares == [[0.5, 0.5], [1.0]]


def test_maps_of_another_size_are_left_out(run, monkeypatch):
    other = write_page_run(run.parent / "other", "fbrl", rising(2, 2), seeds=(7, 8))
    sizes = {run: 4, other: 8}

    def load(run):
        return make(TABLETOP), np.ones((len(run.config.seeds), sizes[run.path], sizes[run.path]), int)

    monkeypatch.setattr(media, "load_visits", load)
    [drawn], [sentence] = maps(read_lines(run, other))
    assert len(drawn["plot"]["shares"]) == 4
    assert sentence == f"No map of fbrl: {other} has maps of 8 bins, another of 4."


def test_a_task_without_a_map_has_none(tmp_path):
    assert maps(read_lines(write_page_run(tmp_path, "fbrl", rising(2, 1), env="franka_kitchen"))) == ([], [])
