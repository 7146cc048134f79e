"""Videos of policies: the median seed, once for each policy, and a cause where there is none."""

import numpy as np
import pytest

from earl_jax import rendering
from earl_jax.envs import make
from earl_jax.errors import InputError
from earl_jax.report.html import policy_videos
from earl_jax.report.html.lines import gather
from earl_jax.report.html.media import VideoEmbedder
from earl_jax.report.html.policy_videos import PolicyVideos, median_lane
from tests.report.html.test_media import VIDEO
from tests.report.run_files import TABLETOP, rising, write_page_run


@pytest.fixture
def rendered(monkeypatch):
    """The arguments of each rendering, which writes a video of a few bytes."""
    calls = []

    def render(source, out, acting, **options):
        calls.append((source, acting, options["seed"], options["steps"]))
        out.write_bytes(VIDEO)
        return out

    monkeypatch.setattr(rendering, "render", render)
    monkeypatch.setattr(policy_videos, "policies_step", lambda path: int(path.read_text()))
    return calls


@pytest.fixture
def run(tmp_path):
    """A run of three seeds, of which seed 1 is the median, with policies at step 20."""
    folder = write_page_run(tmp_path / "run", "fbrl", rising(3, 2))
    (folder / "policies.npz").write_text("20")
    return folder


def test_a_page_has_the_policy_of_the_median_seed(run, rendered):
    [line], _ = gather([run])
    videos, sentences = VideoEmbedder(PolicyVideos()).videos(line)
    assert sentences == []
    [video] = videos
    assert video["name"] == "policy of seed 1, the median of 3, at step 20"
    assert video["uri"].startswith("data:video/mp4;base64,")
    assert rendered == [(run, "policy", 1, round(6 / make(TABLETOP).step_seconds))]
    assert sorted(path.name for path in run.iterdir() if path.suffix) == ["config.json", "metrics.csv", "policies.npz"]
    assert VideoEmbedder().videos(line) == ([], [])


def test_a_policy_is_rendered_once(run, rendered, tmp_path):
    other = write_page_run(tmp_path / "other", "naive", rising(1, 2))
    (other / "policies.npz").write_text("20")
    lines, told = gather([run, other])[0], []
    policies = PolicyVideos(told.append)
    files = [film.file for _ in range(3) for line in lines for _, film in policies.films(line)]
    assert len(rendered) == len(told) == len(set(files)) == 2
    (run / "policies.npz").write_text("30000")
    films = [film for line in lines for _, film in policies.films(line)]
    assert len(rendered) == 3
    assert {film.caption.partition(", at ")[2] for film in films} == {"step 30,000", "step 20"}
    assert films[0].file != films[1].file


def test_a_run_without_a_video_is_named_with_the_cause(run, rendered, monkeypatch):
    def fail(*arguments, **options):
        rendered.append(arguments)
        raise InputError("no way to draw without a display: install EGL\nmore")

    monkeypatch.setattr(rendering, "render", fail)
    [line], _ = gather([run])
    policies = PolicyVideos()
    for _ in range(2):
        videos, [sentence] = VideoEmbedder(policies).videos(line)
        assert videos == []
        assert sentence == f"No video of the policy of {run}: no way to draw without a display: install EGL."
    assert len(rendered) == 1
    (run / "policies.npz").unlink()
    assert VideoEmbedder(policies).videos(line)[1] == [f"No video of the policy of {run}: it has no policies.npz."]


def test_the_median_lane_is_the_lower_one_of_two():
    assert median_lane(np.array([0.9, 0.1, 0.5, 0.4])) == 3
    assert median_lane(np.array([0.3])) == 0
