"""Reports on run folders: tables beside the published numbers, plots and an HTML page."""
