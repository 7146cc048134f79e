"""Files that attack a reader of recordings, by name in `ATTACKS`."""

from collections.abc import Callable

from tests.demos.attack_pickles import PICKLES
from tests.demos.attack_zips import NPZ

ATTACKS: dict[str, Callable[[], bytes]] = {**PICKLES, **NPZ}
"""The content of a file by the name of its attack. None is a recording: a reader must refuse each, quickly."""
