"""Reads a page as a browser does."""

import base64
import gzip
import html.parser
import json
import re


class Reader(html.parser.HTMLParser):
    """The parts of a page: its tags, the links a browser would load, the text it would show, its scripts."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.tags, self.links, self.attributes, self.shown_parts, self.raw = [], [], [], [], {}
        self.element = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [name for name, _ in attrs]
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
