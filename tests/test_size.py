"""The repository stays small enough to clone quickly."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MOST_BYTES = 25 * 2**20


@pytest.mark.skipif(shutil.which("git") is None or not (ROOT / ".git").exists(), reason="needs git and its repository")
def test_the_tracked_files_have_at_most_25_mib():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [path for name in listed.split("\0") if name and (path := ROOT / name).is_file()]
    sizes = {path: path.stat().st_size for path in files}
    largest = ", ".join(str(path.relative_to(ROOT)) for path in sorted(sizes, key=sizes.__getitem__)[-5:])
    assert sum(sizes.values()) <= MOST_BYTES, f"{sum(sizes.values()):,} bytes; the largest are {largest}"
