"""The command that makes one html page of run folders."""

from pathlib import Path

from earl_jax.cli.arguments import Positional


def report(folders: Positional[tuple[Path, ...]], out: Path = Path("report.html")) -> None:
    """Make one self-contained html page of runs: curves, tables, every seed, maps, videos, configs and versions.

    Args:
        folders: run folders, or folders of them: a sweep's, a reproduction's.
        out: the page, .html; one that is there is replaced.
    """
    import jax

    jax.config.update("jax_platforms", "cpu")  # reading checkpoints needs no accelerator, and one may be busy training
    from earl_jax.report.html.writing import write_page

    page = write_page(folders, out)
    print(f"{page}: {page.stat().st_size / 1e6:.1f} MB")
