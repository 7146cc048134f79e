"""Files of pictures and videos."""

from earl_jax.rendering.output import atomic_file


def test_a_link_at_the_temporary_file_is_not_written_through(tmp_path):
    (tmp_path / "victim").write_text("mine")
    (tmp_path / ".video.part.mp4").symlink_to(tmp_path / "victim")
    with atomic_file(tmp_path / "video.mp4") as part:
        part.write_text("frames")
    assert (tmp_path / "victim").read_text() == "mine"
    assert (tmp_path / "video.mp4").read_text() == "frames"
