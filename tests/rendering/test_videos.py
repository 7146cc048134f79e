"""Videos of a policy while it trains: in the run folder, and in the logs."""

import importlib
import io
import shutil

import numpy as np
import pytest

from earl_jax.rendering import VideoLog, videos
from earl_jax.runs.contents import unknown_entries
from earl_jax.runs.files import RunWarning
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.logging import open_logs
from tests.cli.process import succeed, training
from tests.conftest import tiny_train
from tests.runs.test_logging import make_folder

pytest.importorskip("PIL", reason="videos need the extra 'render'")
FRAMES = 6


def test_videos_are_in_the_folder_and_in_tensorboard_also_after_a_resumption_and_change_no_number(
    graphics, monkeypatch, tmp_path
):
    pytest.importorskip("tensorboardX", reason="the test needs the extra 'tensorboard'")
    draw = videos.render
    monkeypatch.setattr(videos, "render", lambda *args, **options: draw(*args, **{**options, "steps": 10}))
    monkeypatch.setattr(videos, "SIZE", (32, 48))
    events = []
    monkeypatch.setattr(
        "tensorboardX.FileWriter.add_summary", lambda _, summary, step, *__: events.append((step, summary))
    )
    out, shown = tmp_path / "run", tmp_path / "run" / "videos"
    succeed(*training(out, "--videos", "1", "--log", "tensorboard"))
    expected = tiny_train("fbrl").metrics
    np.testing.assert_equal(RunFolder.open(out).table().metrics, expected)
    assert sorted(path.name for path in shown.iterdir()) == ["000000120.gif"]
    assert unknown_entries(out) == []
    values = [(step, value) for step, summary in events for value in summary.value]
    [(step, image)] = [(step, value.image) for step, value in values if value.tag == "video/seed_0"]
    assert step == 120
    content = (shown / "000000120.gif").read_bytes()
    assert image.encoded_image_string == content
    with importlib.import_module("PIL.Image").open(io.BytesIO(content)) as film:
        assert (film.n_frames, film.size) == (FRAMES, (image.width, image.height)) == (FRAMES, (48, 32))
    shutil.rmtree(shown)
    shutil.rmtree(out / "checkpoints/000000120")
    succeed("resume", out)
    assert [(path.name, path.read_bytes()) for path in shown.iterdir()] == [("000000120.gif", content)]
    np.testing.assert_equal(RunFolder.open(out).table().metrics, expected)


@pytest.mark.parametrize(("count", "steps"), [(1, [120]), (2, [80, 120]), (3, [40, 80, 120]), (9, [40, 80, 120])])
def test_videos_are_spread_over_the_evaluations(tmp_path, monkeypatch, count, steps):
    drawn = []
    monkeypatch.setattr(videos, "render", lambda source, path, *_, **__: drawn.append(path))
    folder = make_folder(tmp_path / "run")
    *_, log = open_logs(folder, [VideoLog(count)], 0)
    for step in (40, 80, 120):
        log.log(step, {})
    assert drawn == [folder.path / "videos" / f"{step:09d}.gif" for step in steps]


def test_a_video_that_cannot_be_drawn_is_one_warning(tmp_path, monkeypatch):
    monkeypatch.setattr(videos, "render", lambda *_, **__: 1 / 0)
    *_, log = open_logs(make_folder(tmp_path / "run"), [VideoLog(9)], 0)
    with pytest.warns(RunWarning, match="the log videos has failed .* training goes on: division by zero"):
        log.log(40, {})
    log.log(80, {})  # nothing more is tried


def test_videos_need_a_number_and_a_folder():
    with pytest.raises(ValueError, match="videos"):
        VideoLog(0)
    with pytest.raises(ValueError, match="videos are written into a run folder: pass one with out="):
        open_logs(None, [VideoLog(1)], 0)
