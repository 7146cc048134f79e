"""`render`: films, contact sheets, and the actors whose episodes they show."""

import importlib
import sys

import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.rendering import render
from earl_jax.rendering.actors import _actors, actor_of, episodes
from earl_jax.rendering.output import GAP, write_film
from earl_jax.rendering.scenes import Scene
from tests.conftest import tiny_train

pytest.importorskip("mediapy", reason="videos need the extra render")
images = pytest.importorskip("PIL.Image", reason="pictures need the extra render")
TASK = "tabletop_organization"
SMALL = (64, 96)
OF_ONE_TASK = {"policy": "fbrl"}, {"camera": "above"}, {"steps": 3}


@pytest.fixture(scope="module")
def expert_episode():
    return next(episodes(actor_of(TASK)))


def read_video(path):
    metadata, *frames = importlib.import_module("imageio_ffmpeg").read_frames(path)
    return metadata, [np.frombuffer(frame, np.uint8).reshape(*metadata["size"][::-1], 3) for frame in frames]


def test_an_episode_continues_shortly_after_its_goal(expert_episode):
    success = expert_episode.states.metrics["success"]
    assert expert_episode.reached
    assert success[expert_episode.last] == 1
    assert success[: expert_episode.last].sum() == 0
    assert len(success) == expert_episode.last + 7  # 0.6 s


@pytest.mark.parametrize(("suffix", "acting"), [(".gif", "expert"), (".webp", "demos")])
def test_an_animation_has_one_frame_for_each_step(graphics, tmp_path, monkeypatch, suffix, acting):
    monkeypatch.setenv("HOME", str(tmp_path))
    path = render(TASK, f"~/new/x{suffix}", acting=acting, steps=5, size=SMALL)
    assert [entry.name for entry in path.parent.iterdir()] == [f"x{suffix}"]
    with images.open(path) as film:
        film.load()
        assert (film.n_frames, film.size, film.info["duration"]) == (6, SMALL[::-1], 100)
        assert film.info["loop"] == 0  # forever
        first = np.asarray(film.convert("RGB"))
        film.seek(5)
        assert (first != np.asarray(film.convert("RGB"))).any()


@pytest.mark.parametrize(("suffix", "durations"), [(".gif", [20, 30, 30, 20]), (".webp", [25] * 4)])
def test_an_animation_is_as_fast_as_its_film(tmp_path, suffix, durations):
    """A .gif counts in hundredths of a second: frames of 25 ms each had 20."""
    frames = [np.full((8, 8, 3), colour, np.uint8) for colour in (0, 255, 0, 255)]
    with images.open(write_film(tmp_path / f"x{suffix}", frames, 40, (8, 8))) as film:
        for number, duration in enumerate(durations):
            film.seek(number)
            film.load()
            assert film.info["duration"] == duration


def test_demonstrations_that_cannot_be_read_are_named(tmp_path):
    env = make(TASK, demo_file=str(tmp_path / "gone.npz"))
    with pytest.raises(ValueError, match=r"no demos for '.*gone.npz'"):
        next(episodes(_actors(env, None, 0)["demos"]))


def test_fps_makes_a_video_skip_steps(graphics, tmp_path):
    path = render(TASK, tmp_path / "x.mp4", acting="random", steps=8, size=[*SMALL], fps=7)
    metadata, frames = read_video(path)
    assert (len(frames), frames[0].shape, metadata["fps"]) == (5, (*SMALL, 3), 5)
    assert frames[0].std() > 10


def test_a_sheet_shows_six_moments(graphics, tmp_path, expert_episode):
    with images.open(render(TASK, tmp_path / "x.png", size=SMALL)) as sheet:
        pixels = np.asarray(sheet.convert("RGB")).astype(int)
    assert pixels.shape[1] == 6 * SMALL[1] + 5 * GAP
    with Scene(make(TASK), (128, 192)) as scene:
        last = scene.image(expert_episode.at(expert_episode.last))
    reduced = np.asarray(images.fromarray(last).reduce(2)).astype(int)
    assert np.abs(pixels[:64, -96:] - reduced).mean() < 3
    assert np.abs(pixels[:64, :96] - reduced).mean() > np.abs(pixels[:64, -96:] - reduced).mean()
    assert (pixels[64:] < 100).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"source": "nowhere"}, "neither a run folder nor a task; the tasks are cheetah_run"),
        ({"source": make(TASK)}, r"TabletopOrganization\(.*is neither a run folder nor a task"),
        ({"out": "x.webm"}, r"suffix '.webm'; for tabletop_organization choose from .mp4, .gif, .webp, .png"),
        ({"source": "all", "out": "x.mp4"}, "for all choose from .png"),
        ({"acting": "policy"}, "no acting 'policy'; choose from expert, demos, random"),
        ({"acting": "me"}, "unknown acting 'me'; choose from policy"),
        ({"source": "cheetah_run", "acting": "demos"}, "no acting 'demos'; choose from random"),
        ({"policy": "fbrl", "acting": "random"}, "'fbrl' and acting 'random' exclude each other"),
        ({"policy": abs}, "policy is the name of a method, not <built-in function abs>; draw the states"),
        *[({name: 3, "out": "x.png"}, f"a sheet has no {name}: choose a film") for name in ("life", "fps")],
        ({"life": True, "acting": "demos"}, "demonstrations begin where they were recorded"),
        *[({"source": "all", "out": "x.png", **one}, "belongs to one task") for one in OF_ONE_TASK],
        ({"steps": 0}, "steps must lie in"),
        *[({"fps": fps}, "fps must lie in") for fps in (float("nan"), "5")],
        ({"size": (65, 96)}, "even height and width, not 65 and 96"),
        ({"size": 64}, r"size must be a height and a width, such as \(480, 640\), not 64"),
        ({"size": (64, "a")}, "width must be a whole number, not 'a'"),
    ],
)
def test_invalid_arguments_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        render(**{"source": TASK, "out": "x.mp4", **options})


def test_a_missing_library_names_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mediapy", None)
    with pytest.raises(ValueError, match=r"pictures need mediapy: pip install .*'mediapy>="):
        render(TASK, "x.mp4")


def test_a_failed_film_leaves_no_file(graphics, tmp_path, monkeypatch):
    monkeypatch.setattr(Scene, "image", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        render(TASK, tmp_path / "x.mp4", steps=2, size=SMALL)
    assert not list(tmp_path.iterdir())


def test_a_trained_policy_that_ships_reaches_goals_within_its_episodes():
    actor = actor_of(TASK, method="vaprl")
    assert actor.acting == "policy"
    assert next(episodes(actor)).reached


def test_a_life_goes_on_from_its_last_state_and_back_to_an_initial_state():
    actor = actor_of(TASK)
    life = episodes(actor, life=True)
    there, back, again = (next(life) for _ in range(3))
    goals = [episode.at(0).info["goal"] for episode in (there, back, again)]
    assert np.array_equal(goals[1], actor.env.initial_states[0])
    assert all((goal == actor.env.goal_states).all(axis=1).any() for goal in (goals[0], goals[2]))
    for before, after in ((there, back), (back, again)):
        assert np.array_equal(before.at(-1).data.qpos, after.at(0).data.qpos)
    assert back.reached


@pytest.mark.slow
def test_a_run_folder_gets_a_video_of_its_policy(graphics, tmp_path, env, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    tiny_train("fbrl", env, steps=40, out=tmp_path)
    path = render("~", steps=5, size=SMALL)
    assert path == tmp_path / "video.mp4"
    assert len(read_video(path)[1]) == 6
    positions = [next(episodes(actor_of(tmp_path, seed=lane))).states.data.qpos for lane in (0, 1)]
    assert not np.array_equal(*positions)
    assert actor_of(tmp_path, "random").acting == "random"
    with pytest.raises(ValueError, match=r"no seed 2 in .*; choose from 0, 1"):
        actor_of(tmp_path, seed=2)


@pytest.mark.slow
def test_a_sheet_of_all_shows_the_six_tasks(graphics, tmp_path):
    with images.open(render("all", tmp_path / "x.png", size=SMALL)) as sheet:
        width, height = sheet.size
        pixels = np.asarray(sheet.convert("RGB"))
    assert width == 3 * SMALL[1] + 2 * GAP
    for row in range(2):
        for column in range(3):
            x, y = column * (SMALL[1] + GAP), row * height // 2
            assert pixels[y : y + SMALL[0], x : x + SMALL[1]].std() > 20
