"""The command that makes an HTML page of run folders: report."""

from pathlib import Path

from earl_jax.cli.arguments import Last, Positional, WindowSteps, print_line, replacing


def report(
    folders: Positional[tuple[Path, ...]],
    out: Path = Path("report.html"),
    watch: bool = False,
    every: float = 30.0,
    videos: bool = False,
    last: Last = None,
    window: WindowSteps = None,
) -> None:
    """Make one self-contained HTML page of runs: curves, tables, every seed, maps, videos, configs and versions.

    Args:
        folders: Run folders, or folders that contain them, such as those of a sweep or of a reproduction.
        out: Page to write, .html. An existing page is replaced.
        watch: Write the page again whenever a run changes, for a sweep in progress, until Ctrl-C. In a browser it reloads.
        every: Seconds between two looks at the runs with --watch.
        videos: Render six seconds of a policy of each run with policies.npz, its median seed, for the page. It takes some
            seconds a run, and needs the extra render.
    """
    import jax

    jax.config.update("jax_platforms", "cpu")  # an accelerator is not needed, and may be busy with training
    from earl_jax.metrics.scores import Window
    from earl_jax.report.html.media import PolicyVideos
    from earl_jax.report.html.writing import watch_page, write_page

    policies, chosen = PolicyVideos(print_line) if videos else None, Window.of(last, window)
    if watch:
        watch_page(folders, out, every, print_line, policies=policies, window=chosen)
        return
    with replacing(out):
        page = write_page(folders, out, policies=policies, window=chosen)
    print(f"{page}: {page.stat().st_size / 1e6:.1f} MB")
