"""A page of four runs that can be read and three that cannot, and a reader of pages."""

import base64
import gzip
import html.parser
import json
import re

import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.report.html import media
from earl_jax.report.html.curves import lines_of
from earl_jax.report.pooling import read_all
from earl_jax.runs.files import RunWarning
from tests.report.run_files import DOOR, TABLETOP, change_config, rising, write_page_run

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
"""A text that would run a script if a page took it as HTML."""


class Reader(html.parser.HTMLParser):
    """The parts of a page: its tags, the links a browser would load, the text it would show, its scripts."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.tags, self.links, self.shown_parts, self.raw = [], [], [], {}
        self.element = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href", "srcset", "poster", "action", "data")]
        self.element = (dict(attrs).get("id") or "own") if tag == "script" else tag

    def handle_endtag(self, tag):
        self.element = ""

    def handle_data(self, data):
        if self.element in ("plotly", "numbers", "own", "style"):
            self.raw[self.element] = self.raw.get(self.element, "") + data
        else:
            self.shown_parts.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.shown_parts))

    def unpacked(self, name):
        """Return the bytes that the page's script unpacks under `name`."""
        return gzip.decompress(base64.b64decode(self.raw[name]))

    def numbers(self):
        """Return the numbers from which the page's script draws plots."""
        return json.loads(self.unpacked("numbers"))


def read_lines(*folders):
    """Return the lines of a page of `folders`."""
    return lines_of(read_all(folders))


@pytest.fixture(scope="package")
def folders(tmp_path_factory):
    """Two tasks, variants of a method, a run whose texts are HTML, one cut short, and three that cannot be read."""
    root = tmp_path_factory.mktemp("runs")
    write_page_run(root / "fbrl", "fbrl", rising(3, 30), extra_counts=("help/asked",))
    write_page_run(root / "deep" / "naive1", "naive", rising(3, 30, 0.5), planned=600)
    evil = root / "deep" / EVIL.replace("/", "|")
    write_page_run(evil, "naive", rising(2, 30), env_options={"demo_file": EVIL})
    door = write_page_run(root / "door", "oracle", rising(4, 3), env=DOOR)
    change_config(door, provenance={"versions": {"jax": EVIL}, "commit": "a" * 40 + "-dirty"})
    torn, young, alien = (write_page_run(root / name, "r3l", rising(2, 2)) for name in ("torn", "young", "alien"))
    (torn / "config.json").write_text('{"env": ' + EVIL)
    (young / "metrics.csv").unlink()
    lines = (alien / "metrics.csv").read_text().splitlines()
    (alien / "metrics.csv").write_text("\n".join([*lines[:2], "20,0,high"]) + "\n")
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
        return (make(TABLETOP), visits) if folder.path.name == "naive1" else real(folder)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(media, "load_visits", load)
        with pytest.warns(RunWarning, match="left out"):
            return write_page([folders], folders.parent / "page.html")
