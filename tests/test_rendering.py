import importlib

import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.rendering import video as rendering
from earl_jax.rendering.scenes import Scene
from earl_jax.rendering.video import ACTINGS, cast_of, episodes, render, step_seconds
from tests.conftest import tiny_options

pytest.importorskip("mediapy", reason="videos are written with mediapy: pip install 'earl-jax[render]'")
images = pytest.importorskip("PIL.Image", reason="pictures are written with pillow: pip install 'earl-jax[render]'")
TASK = "tabletop_organization"
SMALL = (64, 96)


@pytest.fixture(scope="module")
def drawing():
    try:
        Scene(make(TASK), (8, 8)).close()
    except ValueError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def expert():
    return next(episodes(cast_of(TASK)))


def played(path):
    about, *frames = importlib.import_module("imageio_ffmpeg").read_frames(path)
    return about, [np.frombuffer(frame, np.uint8).reshape(*about["size"][::-1], 3) for frame in frames]


def test_an_episode_goes_on_a_moment_after_its_goal(expert):
    success = expert.states.metrics["success"]
    assert expert.reached
    assert success[expert.last] == 1
    assert success[: expert.last].sum() == 0
    assert len(success) == expert.last + 7  # 0.6 s
    assert float(expert.at(3).data.time) == 3


def test_a_gif_has_a_frame_for_each_step_at_their_pace(drawing, tmp_path):
    path = render(TASK, tmp_path / "new" / "x.gif", steps=5, size=SMALL)
    assert [entry.name for entry in path.parent.iterdir()] == ["x.gif"]
    with images.open(path) as film:
        assert (film.n_frames, film.size, film.info["duration"]) == (6, SMALL[::-1], 100)
        first = np.asarray(film.convert("RGB"))
        film.seek(5)
        assert (first != np.asarray(film.convert("RGB"))).any()


def test_a_video_skips_steps_to_the_rate_asked_for(drawing, tmp_path):
    path = render(TASK, tmp_path / "x.mp4", acting="random", steps=8, size=SMALL, fps=5)
    about, frames = played(path)
    assert (len(frames), frames[0].shape, about["fps"]) == (5, (*SMALL, 3), 5)
    assert frames[0].std() > 10


def test_a_sheet_shows_six_moments(drawing, tmp_path, expert):
    with images.open(render(TASK, tmp_path / "x.png", size=SMALL)) as sheet:
        pixels = np.asarray(sheet.convert("RGB")).astype(int)
    assert pixels.shape[1] == 6 * SMALL[1] + 5 * rendering.GAP
    with Scene(make(TASK), (128, 192)) as scene:
        last = scene.image(expert.at(expert.last))
    shrunk = np.asarray(images.fromarray(last).reduce(2)).astype(int)
    assert np.abs(pixels[:64, -96:] - shrunk).mean() < 3
    assert np.abs(pixels[:64, :96] - shrunk).mean() > np.abs(pixels[:64, -96:] - shrunk).mean()
    assert (pixels[64:] < 100).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"source": "nowhere"}, "neither a run folder nor a task; the tasks are cheetah_run"),
        ({"out": "x.webm"}, r"suffix '.webm'; for tabletop_organization choose from .mp4, .gif, .png"),
        ({"source": "all", "out": "x.mp4"}, "for all choose from .png"),
        ({"acting": "policy"}, "no acting 'policy'; choose from expert, demos, random"),
        ({"acting": "me"}, "unknown acting 'me'; choose from policy"),
        ({"source": "cheetah_run", "acting": "demos"}, "no acting 'demos'; choose from random"),
        ({"steps": 0}, "steps must be above 0"),
        ({"size": (65, 96)}, "even height and width, not 65 and 96"),
    ],
)
def test_what_cannot_be_drawn_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        render(**{"source": TASK, "out": "x.mp4", **options})


def test_a_missing_library_names_its_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mediapy", None)
    with pytest.raises(ValueError, match=r"pip install 'earl-jax\[render\]'"):
        render(TASK, "x.mp4")


def test_a_film_that_fails_leaves_nothing(drawing, tmp_path, monkeypatch):
    monkeypatch.setattr(Scene, "image", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        render(TASK, tmp_path / "x.mp4", steps=2, size=SMALL)
    assert not list(tmp_path.iterdir())


def test_the_pace_is_the_tasks():
    assert step_seconds(make("sawyer_door")) == 0.0125
    assert step_seconds(make(TASK)) == 0.1
    assert set(ACTINGS) == {"policy", "expert", "demos", "random"}


@pytest.mark.slow
@pytest.mark.parametrize("name", [TASK, "sawyer_door", "sawyer_peg"])
def test_demonstrations_reach_their_goals_again(name):
    cast = cast_of(name, "demos")
    demos = cast.env.demos("forward")
    first = int(np.flatnonzero(demos.ends)[0]) + 1
    episode = next(episodes(cast))
    assert episode.reached
    assert abs(episode.last - first) <= 1
    seen = episode.states.obs[1 : episode.last + 1, : cast.env.state_size]
    np.testing.assert_allclose(seen[: first - 1], demos.next_states[: first - 1][: len(seen)], atol=0.02)


@pytest.mark.slow
def test_a_run_folder_gets_a_video_of_its_policy(drawing, tmp_path, env):
    from earl_jax.training import train

    train(env, "fbrl", seeds=2, steps=40, eval_every=40, eval_episodes=2, out=tmp_path, **tiny_options("fbrl"))
    path = render(tmp_path, steps=5, size=SMALL)
    assert path == tmp_path / "video.mp4"
    assert len(played(path)[1]) == 6
    acted = [next(episodes(cast_of(tmp_path, seed=lane))).states.data.qpos for lane in (0, 1)]
    assert not np.array_equal(*acted)
    assert cast_of(tmp_path, "random").acting == "random"
    with pytest.raises(ValueError, match="no lane 2"):
        cast_of(tmp_path, seed=2)


@pytest.mark.slow
def test_all_tasks_are_shown_on_one_sheet(drawing, tmp_path):
    with images.open(render("all", tmp_path / "x.png", size=SMALL)) as sheet:
        width, height = sheet.size
        pixels = np.asarray(sheet.convert("RGB"))
    assert width == 3 * SMALL[1] + 2 * rendering.GAP
    for row in range(2):
        for column in range(3):
            x, y = column * (SMALL[1] + rendering.GAP), row * height // 2
            assert pixels[y : y + SMALL[0], x : x + SMALL[1]].std() > 20
