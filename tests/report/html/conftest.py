"""A page of four runs that can be read and three that cannot."""

import json

import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.report.html import media
from tests.report.run_files import DOOR, TABLETOP, rising, write_page_run

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
"""A text that would run a script if a page took it as HTML."""


@pytest.fixture(scope="package")
def folders(tmp_path_factory):
    """Two tasks, variants of a method, a run whose texts are HTML, one cut short, and three that cannot be read."""
    root = tmp_path_factory.mktemp("runs")
    write_page_run(root / "fbrl", "fbrl", rising(3, 30), extra_counts=("help/asked",))
    write_page_run(root / "deep" / "naive1", "naive", rising(3, 30, 0.5), planned=600)
    evil = root / "deep" / EVIL.replace("/", "|")
    write_page_run(evil, "naive", rising(2, 30), env_options={"demo_file": EVIL})
    write_page_run(root / "door", "oracle", rising(4, 3), env=DOOR)
    config = json.loads((root / "door" / "config.json").read_text())
    config["provenance"]["versions"] = {"jax": EVIL}
    (root / "door" / "config.json").write_text(json.dumps(config))
    for name in ("torn", "young", "alien"):
        write_page_run(root / name, "r3l", rising(2, 2))
    (root / "torn" / "config.json").write_text('{"env": ' + EVIL)
    (root / "young" / "metrics.csv").unlink()
    lines = (root / "alien" / "metrics.csv").read_text().splitlines()
    (root / "alien" / "metrics.csv").write_text("\n".join([*lines[:2], "20,0,high"]) + "\n")
    (root / "deep" / "naive1" / "checkpoints").mkdir()
    broken = root / "fbrl" / "checkpoints" / "000000300"
    broken.mkdir(parents=True)
    (broken / "manifest.json").write_text("{}")
    (root / "fbrl" / "video.gif").write_bytes(b"GIF89a" + bytes(20))
    return root


@pytest.fixture(scope="package")
def written(folders):
    """The page of `folders`, on which one run has a map."""
    pytest.importorskip("jinja2", reason="reports need the extra 'report'")
    pytest.importorskip("plotly", reason="reports need the extra 'report'")
    from earl_jax.report.html.writing import write_page

    visits = np.random.default_rng(0).poisson(0.5, (3, 64, 64))
    real = media.load_visits

    def load(folder):
        has_map = folder.path.name == "naive1"
        return (make(TABLETOP), visits) if has_map else real(folder)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(media, "load_visits", load)
        return write_page([folders], folders.parent / "page.html")
